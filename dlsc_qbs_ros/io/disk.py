"""What the operating system is asked for: whole writes, room that is left, syncs, and locks."""

from __future__ import annotations

from contextlib import contextmanager, suppress
import errno
import fcntl
import os
from pathlib import Path
from typing import BinaryIO, Iterator, Sequence


def write_all(descriptor: int, parts: Sequence[bytes], offset: int) -> None:
    """Write all parts one after the other, past every cache of this process."""
    views = [memoryview(part) for part in parts if part]
    while views:
        n_written = os.pwritev(descriptor, views, offset)
        offset += n_written
        while views and n_written >= len(views[0]):
            n_written -= len(views.pop(0))
        if n_written:
            views[0] = views[0][n_written:]


@contextmanager
def replacement(path: Path, synced: bool) -> Iterator[BinaryIO]:
    """Open a file that replaces another in one step: the old or the new is always there."""
    draft = Path(f'{path}.part')
    try:
        with open(draft, 'wb') as stream:
            yield stream
            stream.flush()
            if synced:
                os.fsync(stream.fileno())
        os.replace(draft, path)
    except OSError:
        with suppress(OSError):
            draft.unlink()
        raise


def sync(path: Path) -> None:
    """Bring a file or folder to the medium; one that is gone by now needs nothing."""
    with suppress(FileNotFoundError):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fdatasync(descriptor)
        except OSError as error:  # some file systems sync no folders
            if error.errno != errno.EINVAL:
                raise
        finally:
            os.close(descriptor)


def free_bytes(path: Path) -> int:
    """Return the room that is left to an ordinary user beside a path."""
    room = os.statvfs(path)
    return room.f_bavail * room.f_frsize


@contextmanager
def locked(directory: Path) -> Iterator[bool]:
    """Hold a folder, as long as this process lives at most; give False when another has it."""
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        is_held = True
    except OSError as error:  # another error is that of a file system without locks
        is_held = error.errno != errno.EWOULDBLOCK
    try:
        yield is_held
    finally:
        os.close(descriptor)
