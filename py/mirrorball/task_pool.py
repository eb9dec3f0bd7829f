"""Tasks in threads or processes of this machine: failed ones are tried again, and a process that dies costs no other task."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass
from threading import Event
from typing import Any

__all__ = ["TaskPool"]

Outcome = tuple[str, Any]
"""Key of a task, and its result or the exception that it failed with at last."""


@dataclass(frozen=True)
class _Attempt:
    key: str
    failures: int = 0


class TaskPool:
    """Calls a function on each of several tasks, which have keys; `stop` is set when the caller gives up."""

    def __init__(
        self,
        function: Callable[[Any], Any],
        tasks: Mapping[str, Any],
        *,
        open_executor: Callable[[int], Executor],
        retries: int,
        stop: Event,
    ) -> None:
        self._function, self._tasks, self._open_executor = function, tasks, open_executor
        self._retries, self._stop = retries, stop

    def outcomes(self, workers: int) -> Iterator[Outcome]:
        """One outcome for each task, as they come."""
        waiting = deque(_Attempt(key) for key in self._tasks)
        while waiting:
            suspects = yield from self._run_until_broken(waiting, workers)
            for suspect in suspects:
                # Alone in its executor, so that the next process that dies is known to be the suspect's.
                alone = deque([suspect])
                while alone:
                    yield from self._run_until_broken(alone, 1)

    def _run_until_broken(self, waiting: deque[_Attempt], workers: int) -> Generator[Outcome, None, list[_Attempt]]:
        """Works on the waiting tasks until none is left or a process dies; returns those one of which may have ended it."""
        running: dict[Future[Any], _Attempt] = {}
        with self._open_executor(workers) as executor:
            try:
                while waiting or running:
                    is_broken = not self._submit(executor, waiting, running, workers)
                    done = wait(running, return_when=FIRST_COMPLETED).done
                    if is_broken or any(_has_died(future) for future in done):
                        return (yield from self._settle_broken(running, waiting))
                    for future in done:
                        yield from self._settle(running.pop(future), future, waiting)
            except BaseException:
                self._stop.set()
                executor.shutdown(wait=False, cancel_futures=True)
                raise
        return []

    def _submit(self, executor: Executor, waiting: deque[_Attempt], running: dict[Future[Any], _Attempt], workers: int) -> bool:
        """Gives each free worker a task, and no more: few tasks are suspect when a process dies. False: one has died."""
        while waiting and len(running) < workers:
            try:
                future = executor.submit(self._function, self._tasks[waiting[0].key])
            except BrokenExecutor:
                return False
            running[future] = waiting.popleft()
        return True

    def _settle_broken(
        self, running: dict[Future[Any], _Attempt], waiting: deque[_Attempt]
    ) -> Generator[Outcome, None, list[_Attempt]]:
        died = {future: attempt for future, attempt in running.items() if _has_died(future)}
        for future, attempt in running.items():
            # One that ran alone failed. Of several nobody knows which one, so that none is counted as a failure.
            if future not in died or len(died) == 1:
                yield from self._settle(attempt, future, waiting)
        return list(died.values()) if len(died) > 1 else []

    def _settle(self, attempt: _Attempt, future: Future[Any], waiting: deque[_Attempt]) -> Iterator[Outcome]:
        error = future.exception()
        if error is None:
            yield attempt.key, future.result()
        elif attempt.failures < self._retries and not isinstance(error, ValueError | FileNotFoundError):
            waiting.append(_Attempt(attempt.key, attempt.failures + 1))
        else:
            yield attempt.key, error


def _has_died(future: Future[Any]) -> bool:
    """Waits for the future."""
    return isinstance(future.exception(), BrokenExecutor)
