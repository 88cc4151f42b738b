"""Files and folders that appear whole or not at all.

Data goes to a hidden temporary neighbor first, is flushed to the disk, and gets its final name by one `os.replace`. A
process that is killed at any moment leaves the previous content, and at most a temporary, which `recover` deletes.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

_TEMPORARY = ".tmp"
_DISPLACED = ".old"


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary file to write; it becomes `path` when the block ends without an error.

    Args:
        path: The file to create or replace; a missing folder is created.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = _temporary_neighbor(path)
    try:
        yield temporary
        _sync(temporary, os.O_RDWR)
        os.replace(temporary, path)
        _sync_folder(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


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
    staged.mkdir()
    try:
        yield staged
        for folder, _, _ in os.walk(staged):
            _sync_folder(Path(folder))
        displaced = final.with_name(f".{final.name}{_DISPLACED}")
        if final.exists():
            # A folder with files cannot be replaced in one step. Between these two renames the old folder has only its
            # hidden name; after a crash there, `recover` renames it back.
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
    """Delete the leftovers of a crash in `parent`, and restore a folder that was being replaced."""
    for displaced in parent.glob(f".*{_DISPLACED}"):
        final = parent / displaced.name.removeprefix(".").removesuffix(_DISPLACED)
        if final.exists():
            shutil.rmtree(displaced, ignore_errors=True)
        else:
            os.replace(displaced, final)
    for temporary in parent.glob(f".*{_TEMPORARY}"):
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink(missing_ok=True)


def _temporary_neighbor(path: Path) -> Path:
    # Not `tempfile`: its files are private to the user whatever the umask says.
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}{_TEMPORARY}")


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
