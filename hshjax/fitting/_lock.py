"""A place on disk that one run has at a time."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import fcntl
except ModuleNotFoundError:  # on Windows
    fcntl = None

WITHOUT_LOCKS = (errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK)
"""What some network file systems answer."""


@contextmanager
def held(path: Path) -> Iterator[None]:
    """For the body, no other run has the file `path`, which is there so long. A killed process has nothing any more.

    On Windows, and on file systems that know no locks, nobody looks after that: two runs are then not told apart.

    **Raises:** ValueError where another run has it.
    """
    if fcntl is None:
        yield
        return
    with path.open("ab") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ValueError(f"{path.parent} is in use by another run: give each a place of its own") from error
        except OSError as error:
            if error.errno not in WITHOUT_LOCKS:
                raise
        if not path.exists() or not os.path.samestat(os.fstat(file.fileno()), path.stat()):
            raise ValueError(f"{path.parent} was in use by another run until now: try again")
        try:
            yield
        finally:
            path.unlink(missing_ok=True)  # before it is closed: whoever comes now makes a file of his own
