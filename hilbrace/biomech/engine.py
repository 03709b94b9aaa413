"""The engine: a separate process that holds the OpenSim model and answers in plain arrays.

OpenSim's wheel and other wheels ship different builds of one shared library, so that a process that
imports OpenSim must import nothing else of weight. The process also keeps native crashes, console noise
and log files away from the caller.

Both ends of the conversation live here: `Engine` for the caller, `serve` for the process. They exchange
pickled tuples over the process's own pipes, which nobody else can reach.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import hilbrace
from hilbrace import errors
from hilbrace.errors import HilbraceError, SolverError

Report = Callable[[int, int], None]
"""Progress callback: (done, total)."""

SILENCE_S = 120.0
"""Seconds without a word after which the process counts as hung; progress is reported far more often."""
START_S = 300.0
"""Seconds that the process may take to load OpenSim (8 s measured from a cold disk)."""

INSTALL = "install it into this Python: pip install opensim"
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class Engine:
    """A running OpenSim process; use it as a context manager.

    One engine answers one call after the other. After an error of the process (crash, hang) it is gone and
    a new engine must be started; after a refused call it goes on.

    Args:
        silence_s: Seconds without answer or progress after which a call fails [s].

    Raises:
        SolverError: On entering, when OpenSim cannot be loaded.
    """

    def __init__(self, silence_s: float = SILENCE_S) -> None:
        self._silence_s = silence_s
        self._process: subprocess.Popen[bytes] | None = None
        self._answers: queue.Queue[tuple[Any, ...]] = queue.Queue()
        self._resources = contextlib.ExitStack()

    def __enter__(self) -> Engine:
        folder = self._resources.enter_context(
            tempfile.TemporaryDirectory(prefix="hilbrace-opensim-", ignore_cleanup_errors=True)
        )
        root = str(Path(hilbrace.__file__).parents[1])
        paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
        environment = os.environ | dict.fromkeys(ONE_THREAD, "1") | {"PYTHONPATH": os.pathsep.join(paths)}
        self._process = subprocess.Popen(
            [sys.executable, "-c", "from hilbrace.biomech.engine import serve; serve()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=folder,
            env=environment,
        )
        reader = threading.Thread(target=_listen, args=(self._process.stdout, self._answers), daemon=True)
        reader.start()
        self._resources.callback(reader.join)
        try:
            self._answer("start", None, START_S)
        except BaseException:
            self._close(patience_s=0.0)
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._close(patience_s=2.0 if kind is None else 0.0)

    def _close(self, patience_s: float) -> None:
        """End the process, by closing its pipe if it listens, by force if not."""
        process, self._process = self._process, None
        if process is not None and process.stdin is not None and process.stdout is not None:
            with contextlib.suppress(OSError):
                process.stdin.close()
            try:
                process.wait(patience_s)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            self._resources.close()
            process.stdout.close()

    @property
    def pid(self) -> int | None:
        """Number of the process; None while none runs."""
        return self._process.pid if self._process else None

    def call(self, task: str, *, progress: Report | None = None, **arguments: Any) -> Any:
        """Have the process do one task.

        Args:
            task: Name of a task of `hilbrace.biomech.opensim_worker`.
            progress: Called with (done, total) while the task goes on.
            **arguments: The task's arguments: arrays, numbers, texts, and lists or dicts of them.

        Raises:
            HilbraceError: The task refused its input, as the error it raised.
            SolverError: The process crashed, hung or failed.
        """
        process = self._process
        if process is None or process.stdin is None:
            raise SolverError(
                "the OpenSim process is not running", where=task, hint="use the engine inside a with block"
            )
        try:
            pickle.dump((task, arguments), process.stdin, protocol=5)
            process.stdin.flush()
        except OSError:
            raise self._ended(task) from None
        return self._answer(task, progress, self._silence_s)

    def _answer(self, task: str, progress: Report | None, silence_s: float) -> Any:
        """Wait for the answer to a task, however long it takes, as long as there is progress."""
        while True:
            try:
                kind, *content = self._answers.get(timeout=silence_s)
            except queue.Empty:
                if self._process:
                    self._process.kill()
                raise SolverError(
                    f"OpenSim gave no sign for {silence_s:g} s and was stopped",
                    where=task,
                    hint="look for frames with few or misplaced markers, or shorten motion.window",
                ) from None
            if kind == "progress" and progress is not None:
                progress(*content)
            elif kind == "result":
                return content[0]
            elif kind == "refused":
                name, what, where, hint = content
                raise getattr(errors, name)(what, where=where, hint=hint)
            elif kind == "failed":
                raise SolverError(
                    f"OpenSim failed: {content[0]}",
                    where=task,
                    hint="check the model file and the markers; the cause is in the details of this error",
                ) from RuntimeError(content[1])
            elif kind == "ended":
                raise self._ended(task)

    def _ended(self, task: str) -> SolverError:
        code = self._process.wait() if self._process else 0
        reason = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return SolverError(
            f"the OpenSim process ended ({reason})",
            where=task,
            hint="run `hilbrace doctor`; if it came from your own biomech.model, try without it",
        )


def _listen(stream: IO[bytes], answers: queue.Queue[tuple[Any, ...]]) -> None:
    """Put every message of the process into the queue, and a last word when its pipe closes."""
    while True:
        try:
            answers.put(pickle.load(stream))
        except (EOFError, OSError, ValueError, pickle.UnpicklingError):
            answers.put(("ended",))
            return


def serve() -> None:
    """Answer calls from the pipes until the caller closes them. Entry point of the process."""
    requests, replies = _take_pipes()

    def send(*message: Any) -> None:
        pickle.dump(message, replies, protocol=5)
        replies.flush()

    try:
        from hilbrace.biomech.opensim_worker import Worker
    except ImportError as fault:
        send("refused", "SolverError", f"OpenSim cannot be loaded: {fault}", "opensim", INSTALL)
        return
    worker = Worker(lambda done, total: send("progress", done, total))
    send("result", None)
    for task, arguments in _requests(requests):
        try:
            result = getattr(worker, task)(**arguments)
        except HilbraceError as fault:
            send("refused", type(fault).__name__, fault.what, fault.where, fault.hint)
        except Exception as fault:  # noqa: BLE001 - the border of the process: every failure must be told
            last_line = str(fault).strip().splitlines()
            send("failed", last_line[0] if last_line else type(fault).__name__, traceback.format_exc())
        else:
            send("result", result)


def _take_pipes() -> tuple[IO[bytes], IO[bytes]]:
    """Keep the pipes for ourselves and send whatever native code prints to nowhere."""
    requests, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    with open(os.devnull, "r+b") as nowhere:
        os.dup2(nowhere.fileno(), 0)
        os.dup2(nowhere.fileno(), 1)
    return requests, replies


def _requests(stream: IO[bytes]) -> Iterator[tuple[str, dict[str, Any]]]:
    while True:
        try:
            yield pickle.load(stream)
        except EOFError:
            return
