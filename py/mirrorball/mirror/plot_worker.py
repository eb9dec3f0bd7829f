"""Draws figures in this process or in a second one, which loads matplotlib while the first still computes."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pickle
import signal
import traceback
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from mirrorball.output_file import replacing

if TYPE_CHECKING:
    from mirrorball.mirror.optical_analysis import OpticalAnalysis
    from mirrorball.mirror.tolerances import GroundErrors

RC_PARAMS: Any = {
    # Text stays text: small files that a reader can search, and no glyph outlines to compute.
    "svg.fonttype": "none",
    "svg.hashsalt": "mirrorball",
    # A fixed place: else every tick's text is measured only to keep the title off it, a sixth of the drawing.
    "axes.titley": 1.0,
    # Hinting moves strokes onto pixels; a tenth of the drawing.
    "text.hinting": "none",
}
"""How matplotlib draws the figures of a page."""


PIPE_BYTES = 1 << 20
"""A design's analysis takes a few hundred kilobytes; the system's usual 64 would block."""


def draw(subject: OpticalAnalysis | GroundErrors, names: Sequence[str], folder: Path) -> None:
    """Draws these functions of `figures` as SVG and PNG into a folder."""
    import matplotlib

    from mirrorball.mirror import figures

    with matplotlib.rc_context(RC_PARAMS):
        for name in names:
            figure = getattr(figures, name)(subject)
            with replacing(folder / f"{name}.svg") as part:
                figure.savefig(part, format="svg", metadata={"Date": None})
            with replacing(folder / f"{name}.png") as part:
                figure.savefig(part, format="png", pil_kwargs={"compress_level": 1})


class PlotWorker:
    """A forked process that loads matplotlib at once and then draws what it is given, a context to work in.

    A program with threads of its own (a notebook) had better not fork. Where no process can be forked, there is no second
    one: `draw` does the work itself.
    """

    def __init__(self) -> None:
        self._worker_pid: int | None = None
        if not hasattr(os, "fork"):
            return
        jobs, self._job_pipe = os.pipe()
        self._error_pipe, errors = os.pipe()
        # A job fits, so that whoever hands it over need not wait until matplotlib is loaded.
        if hasattr(fcntl, "F_SETPIPE_SZ"):
            with contextlib.suppress(OSError):
                fcntl.fcntl(self._job_pipe, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        self._worker_pid = os.fork()
        if self._worker_pid == 0:
            os.close(self._job_pipe)
            os.close(self._error_pipe)
            _worker_loop(jobs, errors)
        os.close(jobs)
        os.close(errors)

    def __enter__(self) -> PlotWorker:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._wait()

    def draw(self, subject: OpticalAnalysis | GroundErrors, names: Sequence[str], folder: Path) -> None:
        """As `draw`, in parallel to the caller until `finish`."""
        if self._worker_pid is None:
            draw(subject, names, folder)
            return
        with os.fdopen(os.dup(self._job_pipe), "wb") as jobs:
            pickle.dump((subject, list(names), folder), jobs)

    def finish(self) -> None:
        """Waits until all is drawn; OSError if a figure could not be written."""
        status, error = self._wait()
        if error:
            raise OSError(*error)
        if status != 0:
            raise OSError("a figure could not be written")

    def abandon(self) -> None:
        """Kills the process, so that it writes nothing more; a later `finish` does not wait."""
        if self._worker_pid is not None:
            os.kill(self._worker_pid, signal.SIGKILL)
            self._wait()

    def _wait(self) -> tuple[int, tuple[Any, ...]]:
        """Exit status of the process, and the arguments of the OSError that ended it, if one did."""
        if self._worker_pid is None:
            return 0, ()
        os.close(self._job_pipe)
        child, self._worker_pid = self._worker_pid, None
        with os.fdopen(self._error_pipe, "rb") as errors:
            error = errors.read()
        return os.waitpid(child, 0)[1], pickle.loads(error) if error else ()


def _worker_loop(jobs: int, errors: int) -> None:
    """Draws until there is no more; never returns: what is the parent's (buffers, atexit) is not to be cleaned up here."""
    try:
        from mirrorball.mirror import figures  # noqa: F401 (loads matplotlib before the first job comes)

        with os.fdopen(jobs, "rb") as queue:
            while queue.peek(1):
                draw(*pickle.load(queue))
        os._exit(0)
    except KeyboardInterrupt:
        # The parent reports the signal, if it got it, too.
        os._exit(1)
    except OSError as error:
        # A full disk: the parent says so.
        reason = (error.errno, error.strerror, error.filename) if error.errno else (str(error),)
        os.write(errors, pickle.dumps(reason))
        os._exit(1)
    except BaseException:
        traceback.print_exc()
        os._exit(1)
