"""A folder that one process writes into."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from optipromp.core.errors import InvalidRequestError


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Keep other processes out of a folder, where the system can lock files."""
    try:
        with path.open("ab") as file:
            if find_spec("fcntl") is not None:
                import fcntl

                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield
    except BlockingIOError:
        raise InvalidRequestError(
            f"another study writes into {path.parent}: wait for its end, or choose another folder"
        ) from None
