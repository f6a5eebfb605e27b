"""What tests of recordings share: a message type of their own, and a disk as small as needed."""

import errno
import os
import struct

TYPE = 'note_msgs/msg/Note'
DEFINITIONS = {
    'Note.msg': 'note_msgs/Text[<=9] texts\nbool LOUD=true\n', 'Text.msg': 'string data\n'}


def install_definitions(prefix, monkeypatch):
    """Install `note_msgs`, which no Python package of that name could be imported for."""
    folder = prefix / 'share' / 'note_msgs' / 'msg'
    folder.mkdir(parents=True)
    for name, text in DEFINITIONS.items():
        (folder / name).write_text(text)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(prefix))


def note(number, n_bytes=0):
    """Return a serialised Note of one text, the number and at least so many bytes."""
    data = f'{number}'.encode().ljust(n_bytes, b'.') + b'\0'
    return b'\0\1\0\0' + struct.pack('<II', 1, len(data)) + data


def _size_bytes(path):
    try:
        return path.stat().st_size
    except FileNotFoundError:  # renamed or deleted meanwhile, by another thread
        return 0


class SmallDisk:
    """
    A disk of so many bytes for what lies in one folder; raises as a full one does.

    `error` may stand for another failure, `limit` for a limit of a file's size.
    """

    def __init__(self, folder, monkeypatch, size_bytes, error=errno.ENOSPC, limit_bytes=None):
        self.folder, self.size_bytes, self.error = folder, size_bytes, error
        self.limit_bytes = limit_bytes
        self._pwritev, self._fallocate = os.pwritev, os.posix_fallocate
        monkeypatch.setattr(os, 'pwritev', self.pwritev)
        monkeypatch.setattr(os, 'posix_fallocate', self.posix_fallocate)

    def free_bytes(self):
        """Return the room that is left."""
        return self.size_bytes - sum(map(_size_bytes, self.folder.glob('*')))

    def pwritev(self, descriptor, buffers, offset):
        """Write as much as fits, and raise when that is nothing."""
        n_bytes = sum(map(len, buffers))
        growth = offset + n_bytes - os.fstat(descriptor).st_size
        fitting = n_bytes - max(growth - max(self.free_bytes(), 0), 0)
        if self.limit_bytes is not None:
            fitting = min(fitting, self.limit_bytes - offset)
        if fitting <= 0:
            raise OSError(self.error, os.strerror(self.error))
        return self._pwritev(descriptor, [b''.join(buffers)[:fitting]], offset)

    def posix_fallocate(self, descriptor, offset, n_bytes):
        """Make a file larger, or raise."""
        growth = offset + n_bytes - os.fstat(descriptor).st_size
        if growth > self.free_bytes():
            raise OSError(self.error, os.strerror(self.error))
        self._fallocate(descriptor, offset, n_bytes)
