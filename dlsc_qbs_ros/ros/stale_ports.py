"""What Fast DDS leaves in shared memory of a process that was killed."""

from contextlib import contextmanager, ExitStack
from fcntl import flock, LOCK_NB, LOCK_SH
from pathlib import Path
from typing import Iterator

SHARED_MEMORY = Path('/dev/shm')
LOCKS = 'fastrtps_port*_el'  # each locked by who receives there


@contextmanager
def stale_ports_avoided() -> Iterator[None]:
    """
    Let no participant made meanwhile receive at a port of a process that was killed.

    Fast DDS takes such a port as free and puts new memory in its place; who sent to it before
    goes on writing to the old one, for 1 to 3 s until that is found out, and what was on its way
    to the dead process fills the sender's memory, so that large messages may find no room for
    much longer. A port that is locked is taken for in use, and left alone.
    """
    with ExitStack() as held:
        for path in SHARED_MEMORY.glob(LOCKS):
            try:
                lock = held.enter_context(path.open())
                flock(lock, LOCK_SH | LOCK_NB)  # shared: others may be starting too
            except OSError:  # in use, gone meanwhile, or another user's
                continue
        yield
