"""Fingerprints of functions: whether the code and the values that a result depends on are the same.

What counts is the compiled code of a function (not its comments or layout), its defaults, the values
that it encloses, and the globals that it uses: data, and functions and classes of the same module,
followed in turn. What it uses of other modules counts by name only.
"""

from __future__ import annotations

import functools
import hashlib
import re
import types
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np


def fingerprint(thing: Any) -> str:
    """Return 16 hexadecimal digits that change when the code or the values of ``thing`` do."""
    return hashlib.sha256("\n".join(_tokens(thing, None, {})).encode()).hexdigest()[:16]


def qualified_name(thing: Any) -> str:
    """Return ``module.name`` of a function, class or callable object."""
    while isinstance(thing, functools.partial):
        thing = thing.func
    named = thing if hasattr(thing, "__qualname__") else type(thing)
    return f"{named.__module__}.{named.__qualname__}"


def _tokens(thing: Any, module: str | None, seen: dict[int, Any]) -> Iterator[str]:
    """Describe ``thing``, met in code of ``module`` (None: given by the user)."""
    if thing is None or isinstance(thing, bool | int | float | complex | str | bytes):
        yield repr(thing)
        return
    if id(thing) in seen:
        yield "seen"
        return
    seen[id(thing)] = thing  # kept: what comes and goes leaves its id to others
    if isinstance(thing, np.ndarray):
        yield f"array {thing.dtype} {thing.shape}"
        yield hashlib.sha256(np.ascontiguousarray(thing).tobytes()).hexdigest()
    elif isinstance(thing, np.generic):
        yield repr(thing)
    elif isinstance(thing, list | tuple):
        yield f"{type(thing).__name__} of {len(thing)}"
        for item in thing:
            yield from _tokens(item, module, seen)
    elif isinstance(thing, Mapping):
        yield f"mapping of {len(thing)}"
        for name in sorted(thing, key=repr):
            yield repr(name)
            yield from _tokens(thing[name], module, seen)
    elif isinstance(thing, set | frozenset):
        yield "set"
        yield from sorted("\n".join(_tokens(item, module, dict(seen))) for item in thing)
    elif isinstance(thing, functools.partial):
        yield "partial"
        for part in (thing.func, thing.args, thing.keywords):
            yield from _tokens(part, module, seen)
    elif isinstance(thing, types.MethodType):
        yield from _tokens(thing.__func__, module, seen)
        yield from _tokens(thing.__self__, module, seen)
    elif thing is np.random.mtrand._rand:  # everybody's, which scipy's distributions refer to
        yield "numpy's own random numbers"
    elif isinstance(thing, types.ModuleType):
        yield f"module {thing.__name__}"
    elif hasattr(thing, "py_func"):  # compiled by numba
        yield from _tokens(thing.py_func, module, seen)
    elif isinstance(thing, types.FunctionType):
        yield thing.__qualname__
        if module is None or thing.__module__ == module:
            yield from _function(thing, seen)
        else:
            yield thing.__module__
    elif isinstance(thing, type):
        yield f"class {thing.__module__}.{thing.__qualname__}"
        if module is None or thing.__module__ == module:
            yield from _class(thing, seen)
    else:
        yield from _tokens(type(thing), module, seen)
        yield from _tokens(_value(thing), module, seen)


def _value(thing: Any) -> Any:
    """Return what an object consists of: what pickle would keep of it, without what it has cached."""
    try:
        reduced = thing.__reduce_ex__(2)
    except Exception:  # a lock, a file: what it is must do
        return re.sub(r"0x[0-9a-fA-F]+", "", repr(thing))
    if isinstance(reduced, str):
        return reduced
    make, arguments, state, items, pairs = (*reduced, None, None, None)[:5]
    if isinstance(state, dict):
        kept = functools.cached_property
        state = {k: v for k, v in state.items() if not isinstance(getattr(type(thing), str(k), None), kept)}
    return qualified_name(make), arguments, state, list(items or ()), list(pairs or ())


def _function(function: types.FunctionType, seen: dict[int, Any]) -> Iterator[str]:
    module = function.__module__
    yield from _code(function.__code__)
    for cell in function.__closure__ or ():
        try:
            yield from _tokens(cell.cell_contents, module, seen)
        except ValueError:  # an empty cell
            yield "empty"
    yield from _tokens(function.__defaults__, module, seen)
    yield from _tokens(function.__kwdefaults__, module, seen)
    for name in sorted(_names(function.__code__)):
        if name in function.__globals__:
            yield name
            yield from _tokens(function.__globals__[name], module, seen)


def _class(cls: type, seen: dict[int, Any]) -> Iterator[str]:
    for name, value in sorted(vars(cls).items()):
        value = getattr(value, "__func__", value)  # static and class methods
        value = value.fget if isinstance(value, property) else value
        if isinstance(value, types.FunctionType) and value.__module__ != cls.__module__:
            continue  # generated, as by dataclass
        if name.startswith("__") and not isinstance(value, types.FunctionType):
            continue
        if isinstance(value, types.MemberDescriptorType | types.GetSetDescriptorType):
            continue
        yield name
        yield from _tokens(value, cls.__module__, seen)
    for base in cls.__bases__:
        yield from _tokens(base, cls.__module__, seen)


def _code(code: types.CodeType) -> Iterator[str]:
    yield code.co_code.hex()
    yield repr((code.co_names, code.co_varnames, code.co_freevars, code.co_argcount, code.co_flags))
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _code(constant)
        elif isinstance(constant, frozenset):
            yield repr(sorted(constant, key=repr))
        else:
            yield repr(constant)


def _names(code: types.CodeType) -> set[str]:
    inner = (_names(c) for c in code.co_consts if isinstance(c, types.CodeType))
    return set(code.co_names).union(*inner)
