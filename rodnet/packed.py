"""Arrays that go to kernels as one number: handing over forty one by one costs more than a small kernel's work.

`Packed` keeps the arrays and a table of where they are; the address of that table is what a kernel is
called with, and `unpack` is how it gets its arrays back. Both name the same layout, a text such as
``"x:d2 edges:l2"``: of each array its name, its type (d for float64, i for int32, l for int64) and its
number of dimensions.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array

from rodnet.compiled import config

_TYPES = {"d": types.float64, "i": types.int32, "l": types.int64}
_DTYPES = {"d": np.dtype(np.float64), "i": np.dtype(np.int32), "l": np.dtype(np.int64)}
_WORD = ir.IntType(64)


def _entries(layout: str) -> list[tuple[str, str, int]]:
    """Name, type and number of dimensions of each array of a layout."""
    return [(name, form[0], int(form[1])) for name, form in (entry.split(":") for entry in layout.split())]


class Packed:
    """Arrays for kernels, to be written to in place but not exchanged.

    Parameters
    ----------
    layout : str
        Names, types and dimensions.
    *arrays : ndarray, C-contiguous
        The arrays in the order of the layout.

    Attributes
    ----------
    table : int
        What to call a kernel with. It is valid as long as this object lives.

    Raises
    ------
    TypeError
        An array is not what the layout says.
    """

    def __init__(self, layout: str, *arrays: np.ndarray) -> None:
        words: list[int] = []
        for (name, kind, dimensions), array in zip(_entries(layout), arrays, strict=True):
            if (array.dtype, array.ndim) != (_DTYPES[kind], dimensions) or not array.flags.c_contiguous:
                raise TypeError(
                    f"{name} must be a C-contiguous array of {_DTYPES[kind]} with {dimensions} dimensions, "
                    f"not of {array.dtype} with {array.ndim}"
                )
            words += [array.ctypes.data, *array.shape]
        self._words, self._arrays = np.array(words, dtype=np.int64), arrays
        # where kernels are not compiled, for debugging, the table is the arrays themselves
        self.table: Any = arrays if config.DISABLE_JIT else self._words.ctypes.data


def _unpack(typing_context, table, layout):
    """Return the arrays of a `Packed` of the given layout, in a kernel: a tuple."""
    if not isinstance(layout, types.StringLiteral):
        return None  # numba then says that no such function fits
    forms = [types.Array(_TYPES[kind], n, "C") for _, kind, n in _entries(layout.literal_value)]

    def generate(context, builder, signature, arguments):
        words = builder.inttoptr(arguments[0], _WORD.as_pointer())
        at = 0

        def word():
            nonlocal at
            at += 1
            return builder.load(builder.gep(words, [ir.Constant(_WORD, at - 1)]))

        arrays = []
        for form in forms:
            item = context.get_data_type(form.dtype)
            data = builder.inttoptr(word(), item.as_pointer())
            shape = [word() for _ in range(form.ndim)]
            strides = [ir.Constant(_WORD, context.get_abi_sizeof(item))]
            for extent in shape[:0:-1]:
                strides.insert(0, builder.mul(strides[0], extent))
            array = make_array(form)(context, builder)
            populate_array(
                array,
                data=data,
                shape=cgutils.pack_array(builder, shape, ty=_WORD),
                strides=cgutils.pack_array(builder, strides, ty=_WORD),
                itemsize=strides[-1],
                meminfo=None,  # the arrays belong to the Packed
            )
            arrays.append(array._getvalue())
        return context.make_tuple(builder, signature.return_type, arrays)

    return types.Tuple(forms)(table, layout), generate


unpack: Any = (lambda table, layout: table) if config.DISABLE_JIT else intrinsic(prefer_literal=True)(_unpack)
