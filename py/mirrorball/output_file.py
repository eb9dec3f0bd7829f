"""How does an output get its name only when it is complete? Written beside it, flushed, then renamed."""

import itertools
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_NUMBERS = itertools.count()


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yields a name `NAME.PROCESS-NUMBER.part` to write to, and gives it the name `path` at the end.

    No other process or thread has this name. After an exception the part is removed and an earlier file is as it was.
    Pipes and devices are written directly.
    """
    path = Path(path).resolve()
    if path.exists() and not path.is_file():
        yield path
        return
    part = path.with_name(f"{path.name}.{os.getpid()}-{next(_NUMBERS)}.part")
    try:
        yield part
        with part.open("rb") as file:
            os.fsync(file.fileno())
        part.replace(path)
    except BaseException as error:
        part.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno is not None and str(error.filename) in ("None", str(part)):
            # A failed write does not name its file, and the part is no name that a user gave.
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
