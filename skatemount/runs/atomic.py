"""Files and folders that appear whole or not at all.

Data goes to a hidden temporary neighbor first, is flushed to the disk, and gets its final name by one `os.replace`. A
process that is killed at any moment leaves the previous content, and at most a temporary, which `recover` deletes.

A temporary is named ``.<name>.<machine>-<process>-<number>.tmp``, so that nobody deletes one that is being written.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import secrets
import shutil
import socket
import time
from collections.abc import Iterator
from pathlib import Path

_TEMPORARY = ".tmp"
_DISPLACED = ".old"
_OWNER = re.compile(r".*\.([0-9a-f]{6})-(\d+)-[0-9a-f]+\.tmp")

_OLDER_OWNER = re.compile(r"\..+\.[0-9a-f]+\.tmp")
"""Names of older versions, which do not tell the process."""

FORGOTTEN = 3600.0
"""Time after its last change at which a temporary of another machine is taken for a leftover, s."""


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary file to write; it becomes `path` when the block ends without an error.

    Args:
        path: The file to create or replace; a missing folder is created.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    clear(path.parent, path.name)
    temporary = _temporary_neighbor(path)
    try:
        with naming(path, temporary):
            yield temporary
            _sync(temporary, os.O_RDWR)
            os.replace(temporary, path)
            _sync_folder(path.parent)
    finally:
        # On a disk that has failed, the first error is the one to report.
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def naming(path: Path, temporary: Path | None = None) -> Iterator[None]:
    """Let an error of the file system name a file or folder, if it names none, or the temporary one.

    A full disk is noticed at a write, which knows no name.

    Args:
        path: The file or folder.
        temporary: The temporary that becomes it.
    """
    try:
        yield
    except OSError as error:
        if error.errno is not None and error.filename is None:
            error.filename = str(path)
        elif temporary is not None and str(error.filename).startswith(str(temporary)):
            error.filename, error.filename2 = str(path) + str(error.filename)[len(str(temporary)) :], None
        raise


def write_bytes(path: Path, data: bytes) -> None:
    """Create or replace a file."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Create or replace a text file (UTF-8, line ends as given)."""
    write_bytes(path, text.encode("utf-8"))


@contextlib.contextmanager
def replacing_folder(final: Path) -> Iterator[Path]:
    """Yield an empty folder to fill; it becomes `final` when the block ends without an error.

    The block flushes the files that it writes, as `write_bytes` does. An existing `final` stays until the new one is
    complete. Only one process at a time may write below a parent folder: leftovers of a crash are deleted first.

    Args:
        final: The folder to create or replace.
    """
    final.parent.mkdir(parents=True, exist_ok=True)
    recover(final.parent)
    staged = _temporary_neighbor(final)
    try:
        with naming(final, staged):
            staged.mkdir()
            yield staged
            for folder, _, _ in os.walk(staged):
                _sync_folder(Path(folder))
            displaced = final.with_name(f".{final.name}{_DISPLACED}")
            if final.exists():
                # A folder with files cannot be replaced in one step. Between these two renames the old folder has only
                # its hidden name; after a crash there, `recover` renames it back.
                os.replace(final, displaced)
            os.replace(staged, final)
            _sync_folder(final.parent)
            shutil.rmtree(displaced, ignore_errors=True)
    finally:
        shutil.rmtree(staged, ignore_errors=True)


def remove_folder(folder: Path) -> None:
    """Delete a folder; it is never visible half deleted under its own name."""
    doomed = _temporary_neighbor(folder)
    os.replace(folder, doomed)
    shutil.rmtree(doomed, ignore_errors=True)


def recover(parent: Path) -> None:
    """Delete the leftovers of a crash in `parent`, and restore a folder that was being replaced.

    Only one process at a time may replace folders in `parent`. Files may be replaced by others meanwhile.
    """
    for displaced in parent.glob(f".*{_DISPLACED}"):
        final = parent / displaced.name.removeprefix(".").removesuffix(_DISPLACED)
        if final.exists():
            shutil.rmtree(displaced, ignore_errors=True)
        else:
            os.replace(displaced, final)
    clear(parent, older=True)


def clear(parent: Path, name: str = "", older: bool = False) -> None:
    """Delete the temporaries in a folder whose process has ended; what cannot be deleted stays.

    Args:
        parent: The folder.
        name: Name of the file or folder that they were to become; any if empty.
        older: Delete those of older versions, too, which do not tell their process, whatever their age.
    """
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(parent)):
            hidden = entry.name.startswith(f".{name}") and entry.name.endswith(_TEMPORARY)
            if not hidden or not _is_left_over(entry, older):
                continue
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path, ignore_errors=True)
            else:
                with contextlib.suppress(OSError):
                    os.unlink(entry.path)


def _is_left_over(temporary: os.DirEntry[str], older: bool) -> bool:
    """Return whether nobody writes a temporary any more."""
    owner = _OWNER.fullmatch(temporary.name)
    if owner is not None and owner[1] == machine() and os.name == "posix":
        return not is_alive(int(owner[2]))
    if owner is None and not _OLDER_OWNER.fullmatch(temporary.name):
        return False
    try:
        age = time.time() - temporary.stat(follow_symlinks=False).st_mtime
    except OSError:
        return False
    return age > FORGOTTEN or owner is None and older


def is_alive(process: int) -> bool:
    """Return whether a process of this machine runs."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        # It belongs to another user.
        return True
    return True


@functools.cache
def machine() -> str:
    """Return a short name of this machine; containers, which number their processes separately, have their own."""
    with contextlib.suppress(OSError):
        return _short(socket.gethostname() + os.readlink("/proc/self/ns/pid"))
    return _short(socket.gethostname())


def _short(name: str) -> str:
    return hashlib.sha256(name.encode(errors="replace")).hexdigest()[:6]


def _temporary_neighbor(path: Path) -> Path:
    # Not `tempfile`: its files are private to the user whatever the umask says.
    return path.with_name(f".{path.name}.{machine()}-{os.getpid()}-{secrets.token_hex(4)}{_TEMPORARY}")


def _sync(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _sync_folder(folder: Path) -> None:
    # Some file systems refuse to flush a folder; the rename is atomic there too.
    with contextlib.suppress(OSError):
        _sync(folder, os.O_RDONLY)
