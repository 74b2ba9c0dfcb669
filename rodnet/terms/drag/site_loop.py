"""The compiled loop over sites that calls a user's compiled per-site law.

The loop is a kernel like the others, compiled once for all laws: it calls the law by its address. A law
is compiled on its own, and kept by numba if its decorator says so.
"""

import math
from functools import cache
from typing import Any

import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from numba.extending import intrinsic

from rodnet.compiled import kernel
from rodnet.errors import TermError
from rodnet.kinematics.kernels import STATE
from rodnet.packed import unpack
from rodnet.terms.drag.kernels import SITES, _scatter, _site_tangent

_NUMBER = types.float64
_VECTOR, _MATRIX = (types.Array(_NUMBER, n, "C") for n in (1, 2))
# (v, x, tangent, radius, t, p, f, dfdv, dfdtangent)
LAW = types.none(
    _VECTOR, _VECTOR, _VECTOR, _NUMBER, _NUMBER, _VECTOR, _VECTOR, _MATRIX, _MATRIX
)  # fmt: skip


@cache  # the machine code lives as long as the law
def law_address(law: Any) -> int:
    """Compile a per-site law for the types of `LAW`, unless that is done; return where its machine code is.

    Raises
    ------
    TermError
        If it is not for numba to compile.
    """
    form = "(v, x, tangent, radius, t, p, f, dfdv, dfdtangent)"
    if not isinstance(law, Dispatcher):
        raise TermError(f"kernel must be a function {form} decorated by rodnet.kernel, got {law!r}")
    try:
        law.compile(LAW.args)
        result: Any = law.overloads[LAW.args]
    except (NumbaError, RuntimeError, TypeError) as error:  # RuntimeError: types of its own are declared
        raise TermError(
            f"the kernel {law.py_func.__name__} cannot be compiled as a function {form}; decorate it by "
            f"rodnet.kernel. {error}"
        ) from error
    if result.signature.return_type != LAW.return_type:
        raise TermError(
            f"the kernel {law.py_func.__name__} must fill its last three arguments, not return a value"
        )
    return result.library.get_pointer_to_function(result.fndesc.llvm_func_name)


def _call(typing_context, address, v, x, tangent, radius, t, p, f, dfdv, dfdtangent):
    """Call the law at an address; what it raises goes on to the caller."""

    def generate(context, builder, signature, arguments):
        convention = context.call_conv
        kind = convention.get_function_type(LAW.return_type, LAW.args)
        law = builder.inttoptr(arguments[0], kind.as_pointer())
        status, _ = convention.call_function(builder, law, LAW.return_type, LAW.args, arguments[1:])
        with cgutils.if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        return context.get_dummy_value()

    return LAW.return_type(types.intp, *LAW.args), generate


call: Any = intrinsic(_call)


@kernel
def site_loop(law, time, sites, state, cv, F, data, with_jac):
    """Add the forces of the law at an address, and their derivatives; return the largest force."""
    p, node, edgeA, edgeB, cA, cB, weight, radius, slots = unpack(sites, SITES)
    x, v, _, _, _, L, T, _, _ = unpack(state, STATE)
    f = np.empty(3)
    dv = np.empty((3, 3))
    dt = np.empty((3, 3))
    t = np.empty(3)
    fmax = 0.0
    for s in range(node.shape[0]):
        _site_tangent(s, edgeA, edgeB, cA, cB, T, t)
        for i in range(3):
            f[i] = 0.0
            for j in range(3):
                dv[i, j] = 0.0
                dt[i, j] = 0.0
        call(law, v[node[s]], x[node[s]], t, radius[s], time, p[s], f, dv, dt)
        for i in range(3):
            f[i] *= weight[s]
            fmax = max(fmax, math.fabs(f[i]))
            for j in range(3):
                dv[i, j] *= weight[s]
                dt[i, j] *= weight[s]
        _scatter(s, f, dv, dt, cv, node, edgeA, edgeB, cA, cB, T, L, F, slots, data, with_jac)
    return fmax
