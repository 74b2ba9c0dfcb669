"""Fingerprints of functions: whether the code and the values that a result depends on are the same.

What counts is the compiled code of a function (not its comments or layout), its defaults, the values
that it encloses, and the globals that it uses: data, and functions and classes of the same module,
followed in turn. What it uses of other modules counts by name, and what functions of these enclose; where they
may be somebody's own, ask for their `sources`, too.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import re
import sys
import sysconfig
import types
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

# whose modules count by their names, wherever they lie: a project may hold its own environment
INSTALLED = (
    Path(__file__).resolve().parents[1],
    *(Path(sysconfig.get_path(name)).resolve() for name in ("stdlib", "platstdlib", "purelib", "platlib")),
)

Seen = dict[int, tuple[int, Any]]  # what was met, by its id: as which number, and the thing

# hashes of sources by module, with its spec: reloading replaces that
_read: dict[str, tuple[Any, str]] = {}


def fingerprint(thing: Any) -> str:
    """Return 16 hexadecimal digits that change when the code or the values of ``thing`` do."""
    return hashlib.sha256("\n".join(_tokens(thing, None, {})).encode()).hexdigest()[:16]


def qualified_name(thing: Any) -> str:
    """Return ``module.name`` of a function, class or callable object."""
    while isinstance(thing, functools.partial):
        thing = thing.func
    named = thing if hasattr(thing, "__qualname__") else type(thing)
    return f"{named.__module__}.{named.__qualname__}"


def _tokens(thing: Any, module: str | None, seen: Seen) -> Iterator[str]:
    """Describe ``thing``, met in code of ``module`` (None: given by the user)."""
    if thing is None or isinstance(thing, bool | int | float | complex | str | bytes):
        yield repr(thing)
        return
    if id(thing) in seen:
        yield f"seen as number {seen[id(thing)][0]}"
        return
    seen[id(thing)] = len(seen), thing  # kept: what comes and goes leaves its id to others
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
            yield from _enclosed(thing, module, seen)
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


def _function(function: types.FunctionType, seen: Seen) -> Iterator[str]:
    module = function.__module__
    yield from _code(function.__code__)
    yield from _enclosed(function, module, seen)
    yield from _tokens(function.__defaults__, module, seen)
    yield from _tokens(function.__kwdefaults__, module, seen)
    for name in sorted(_names(function.__code__)):
        if name in function.__globals__:
            yield name
            yield from _tokens(function.__globals__[name], module, seen)


def _enclosed(function: types.FunctionType, module: str | None, seen: Seen) -> Iterator[str]:
    """What a function encloses: two of one name are made of other values there."""
    for cell in function.__closure__ or ():
        try:
            yield from _tokens(cell.cell_contents, module, seen)
        except ValueError:  # an empty cell
            yield "empty"


def _class(cls: type, seen: Seen) -> Iterator[str]:
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


def sources(functions: Iterable[Any], file: Path | None = None) -> list[tuple[str, str]]:
    """Return names and hashes of the modules that files have imported from their own folders, and these in turn.

    Installed packages are left out, and what nobody has imported. Data that a module reads cannot be seen.

    Parameters
    ----------
    functions : iterable
        The files are those where these functions are defined; what is no function is passed over.
    file : path, optional
        Another one, which is no module.
    """
    files = set() if file is None else {(file, "")}
    for function in functions:
        while isinstance(function, functools.partial):
            function = function.func
        module = sys.modules.get(getattr(function, "__module__", None) or "")
        if callable(function) and getattr(module, "__file__", None):
            files.add(_place(module))
    return sorted({name: _source(module) for one in files for name, module in _beside(*one).items()}.items())


def _beside(file: Path, package: str) -> dict[str, Any]:
    """Modules by name that a file of a package has imported from its folder or below, and these in turn."""
    folder, found, todo = file.parent.resolve(), {}, [(file, package)]
    while todo:
        for name in _imports(*todo.pop()):
            module = sys.modules.get(name)
            if name in found or not getattr(module, "__file__", None):
                continue
            place, around = _place(module)
            real = place.resolve()  # it may be a link in the folder, or the folder one
            inside = place.is_relative_to(folder) or real.is_relative_to(folder)
            if inside and not any(real.is_relative_to(p) for p in INSTALLED):
                found[name] = module
                todo.append((place, around))
    return found


def _place(module: Any) -> tuple[Path, str]:
    return Path(module.__file__).absolute(), module.__package__ or ""


def _imports(file: Path, package: str) -> set[str]:
    """Names of what may be modules that a source imports anywhere, with the packages around them."""
    try:
        tree = ast.parse(file.read_bytes())
    except (OSError, SyntaxError, ValueError):  # compiled, or edited since it was imported
        return set()
    names: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            around = package.rsplit(".", node.level - 1)[0] if node.level else ""
            base = ".".join(filter(None, (around, node.module)))
            names += [base, *(f"{base}.{alias.name}" for alias in node.names)]
    parts = (name.split(".") for name in names)
    return {".".join(p[: k + 1]) for p in parts for k in range(len(p))}


def _source(module: Any) -> str:
    """Hash of a module's source as it was when first asked for: edited later, the code that runs is still that."""
    spec, known = _read.get(module.__name__, (None, ""))
    if not known or spec is not module.__spec__:
        path = _place(module)[0]
        known = hashlib.sha256(path.read_bytes() if path.is_file() else b"").hexdigest()
        _read[module.__name__] = module.__spec__, known
    return known


def packages(modules: Iterable[str]) -> list[tuple[str, str]]:
    """Return names and hashes of the packages that modules are in, with all that these hold.

    rodnet's own are left out, and the module that runs.
    """
    names = {module.partition(".")[0] for module in modules} - {"rodnet", "__main__", "builtins"}
    return [(name, _package(name)) for name in sorted(names)]


@functools.cache
def _package(name: str) -> str:
    """Hash of the sources of a package, or of a module that is in none."""
    sha = hashlib.sha256()
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):  # loaded by hand
        spec = None
    folders = [Path(folder) for folder in (spec.submodule_search_locations or ()) if spec] if spec else []
    file = spec.origin if spec is not None and spec.has_location else None
    files = [path for folder in folders for path in sorted(folder.rglob("*.py"))]
    for path in files or ([Path(file)] if file else []):
        sha.update(path.name.encode() + (path.read_bytes() if path.is_file() else b""))
    return sha.hexdigest()
