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
from rodnet.terms.drag.kernels import SITES, _scatter, site_tangent

_NUMBER = types.float64
_VECTOR, _MATRIX = (types.Array(_NUMBER, n, "C") for n in (1, 2))
FORM = "(v, x, tangent, radius, t, p, f, dfdv, dfdtangent)"
LAW = types.none(
    _VECTOR, _VECTOR, _VECTOR, _NUMBER, _NUMBER, _VECTOR, _VECTOR, _MATRIX, _MATRIX
)  # fmt: skip
# a law that depends on the place fills one more derivative, dfdx
PLACED_LAW = types.none(*LAW.args, _MATRIX)


def is_placed(law: Any) -> bool:
    """Whether a per-site law takes ``dfdx``, its derivative by the place, as a tenth argument."""
    code = getattr(getattr(law, "py_func", law), "__code__", None)  # not compiled, for debugging
    return code is not None and code.co_argcount == len(PLACED_LAW.args)


@cache  # the machine code lives as long as the law
def law_address(law: Any) -> int:
    """Compile a per-site law, unless that is done; return where its machine code is.

    Raises
    ------
    TermError
        If it is not for numba to compile.
    """
    form, kind = (f"{FORM[:-1]}, dfdx)", PLACED_LAW) if is_placed(law) else (FORM, LAW)
    if not isinstance(law, Dispatcher):
        raise TermError(f"kernel must be a function {form} decorated by rodnet.kernel, got {law!r}")
    try:
        law.compile(kind.args)
        result: Any = law.overloads[kind.args]
    except (NumbaError, RuntimeError, TypeError) as error:  # RuntimeError: types of its own are declared
        raise TermError(
            f"the kernel {law.py_func.__name__} cannot be compiled as a function {form}; decorate it by "
            f"rodnet.kernel. {error}"
        ) from error
    if result.signature.return_type != kind.return_type:
        raise TermError(f"the kernel {law.py_func.__name__} must fill its last arguments, not return a value")
    return result.library.get_pointer_to_function(result.fndesc.llvm_func_name)


def _caller(law: Any) -> Any:
    """Make what calls a law at an address, of the type ``law``; what it raises goes on to the caller."""

    def generate(context, builder, signature, arguments):
        convention = context.call_conv
        kind = convention.get_function_type(law.return_type, law.args)
        function = builder.inttoptr(arguments[0], kind.as_pointer())
        status, _ = convention.call_function(builder, function, law.return_type, law.args, arguments[1:])
        with cgutils.if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        return context.get_dummy_value()

    return law.return_type(types.intp, *law.args), generate


def _call(typing_context, address, v, x, tangent, radius, t, p, f, dfdv, dfdtangent):
    return _caller(LAW)


def _call_placed(typing_context, address, v, x, tangent, radius, t, p, f, dfdv, dfdtangent, dfdx):
    return _caller(PLACED_LAW)


call: Any = intrinsic(_call)
call_placed: Any = intrinsic(_call_placed)


@kernel
def site_loop(law, placed, time, sites, state, cv, F, data, with_jac):
    """Add the forces of the law at an address, and their derivatives; return the largest force.

    ``placed`` says that the law fills its derivative by the place, too.
    """
    p, node, edgeA, edgeB, cA, cB, weight, radius, slots = unpack(sites, SITES)
    x, v, _, _, _, L, T, _, _ = unpack(state, STATE)
    f = np.empty(3)
    dv = np.empty((3, 3))
    dt = np.empty((3, 3))
    dx = np.zeros((3, 3))
    t = np.empty(3)
    fmax = 0.0
    for s in range(node.shape[0]):
        site_tangent(s, edgeA, edgeB, cA, cB, T, t)
        for i in range(3):
            f[i] = 0.0
            for j in range(3):
                dv[i, j] = 0.0
                dt[i, j] = 0.0
                dx[i, j] = 0.0
        if placed:
            call_placed(law, v[node[s]], x[node[s]], t, radius[s], time, p[s], f, dv, dt, dx)
        else:
            call(law, v[node[s]], x[node[s]], t, radius[s], time, p[s], f, dv, dt)
        for i in range(3):
            f[i] *= weight[s]
            fmax = max(fmax, math.fabs(f[i]))
            for j in range(3):
                dv[i, j] = weight[s] * (cv * dv[i, j] + dx[i, j])
                dt[i, j] *= weight[s]
        _scatter(s, f, dv, dt, 1.0, node, edgeA, edgeB, cA, cB, T, L, F, slots, data, with_jac)
    return fmax


@kernel
def site_law(law, placed, time, p, v, x, tangent, radius, f, dv, dt, dx):
    """Fill forces per length of the law at an address, and their derivatives, which are zero before."""
    for s in range(radius.shape[0]):
        if placed:
            call_placed(law, v[s], x[s], tangent[s], radius[s], time, p[s], f[s], dv[s], dt[s], dx[s])
        else:
            call(law, v[s], x[s], tangent[s], radius[s], time, p[s], f[s], dv[s], dt[s])
