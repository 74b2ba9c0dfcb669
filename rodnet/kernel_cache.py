"""Where compiled kernels are kept.

In the first of these places that can be written to:

1. the directory that the environment variable ``NUMBA_CACHE_DIR`` names;
2. ``__pycache__`` beside rodnet's sources;
3. the user's cache directory: ``rodnet`` in ``$XDG_CACHE_HOME``, ``~/.cache``, ``~/Library/Caches`` or
   ``%LOCALAPPDATA%``;
4. the system's directory for temporary files.

Each state of the sources has a subdirectory of its own there, because numba would not notice that a
function which a kernel takes from another file has changed.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parent
INSTALLED = PACKAGE / "__pycache__"
KEPT = 4  # states of the sources whose kernels are kept


def sources_key() -> str:
    """Hash of the sources of all kernels: those of the modules that use `rodnet.compiled`."""
    digest = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        text = path.read_bytes()
        if b"rodnet.compiled" in text or path.name == "compiled.py":
            digest.update(text)
    return digest.hexdigest()[:12]


def find_cache(chosen: str = "") -> Path | None:
    """Return the directory for compiled kernels; None if nothing can be written anywhere.

    Parameters
    ----------
    chosen : str
        A directory that is preferred to all others.
    """
    name = f"kernels-{sources_key()}"
    for place in _places(chosen):
        cache = place / name
        try:
            if not cache.is_dir():
                _prepare(cache)
            with tempfile.TemporaryFile(dir=cache, buffering=0) as file:  # the disk may be full, too
                file.write(b" ")
        except OSError:
            continue
        return cache
    return None


def _places(chosen: str) -> Iterator[Path]:
    if chosen:
        yield Path(chosen).absolute()
    yield INSTALLED
    folder = "~/.cache"
    if sys.platform == "win32":
        folder = os.environ.get("LOCALAPPDATA", "~/AppData/Local")
    elif sys.platform == "darwin":
        folder = "~/Library/Caches"
    users = Path(os.path.expanduser(os.environ.get("XDG_CACHE_HOME") or folder))
    if users.is_absolute():  # not so where nobody knows the home directory
        yield users / "rodnet"
    try:
        yield _private(Path(tempfile.gettempdir()))
    except OSError:
        pass


def _private(folder: Path) -> Path:
    """Return our directory in one where others write too; what is in it will be executed."""
    if sys.platform == "win32":  # each user has a directory for temporary files
        return folder / "rodnet"
    ours = folder / f"rodnet-{os.getuid()}"
    ours.mkdir(mode=0o700, exist_ok=True)
    status = ours.lstat()
    if status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise PermissionError(f"'{ours}' is somebody else's")
    return ours


def _prepare(cache: Path) -> None:
    """Make the directory, with the kernels that a read-only install brings along; drop the oldest."""
    cache.parent.mkdir(parents=True, exist_ok=True)
    others = sorted(cache.parent.glob("kernels-*"), key=os.path.getmtime)
    for old in others[: 1 - KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    brought = INSTALLED / cache.name
    if cache != brought and brought.is_dir():
        copy = cache.with_name(f".{cache.name}-{os.getpid()}")
        for file in brought.glob("*/*"):  # but not their modes
            (copy / file.parent.name).mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, copy / file.parent.name / file.name)
        try:
            copy.rename(cache)
        except OSError:  # another process was first, or there was nothing to copy
            shutil.rmtree(copy, ignore_errors=True)
    cache.mkdir(exist_ok=True)
