"""A training in several processes of this host, one for each GPU, started and watched by torchrun's agent.

The agent gives each process its rank, and ends all of them when one fails. It is called as ``torchrun --standalone
--nproc-per-node N`` calls it, but for signals. torchrun passes them on and kills what still runs 30 s later (torch 2.11
cannot change that), and a second signal makes it leave its processes behind. So signals go to the processes directly,
which end by themselves once their checkpoint is written.
"""

from __future__ import annotations

import os
import signal
import sys
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path

import torch
from torch.distributed.elastic.agent.server.api import RunResult, WorkerSpec
from torch.distributed.elastic.agent.server.local_elastic_agent import LocalElasticAgent
from torch.distributed.elastic.multiprocessing import DefaultLogsSpecs
from torch.distributed.elastic.rendezvous import RendezvousParameters
from torch.distributed.elastic.rendezvous.registry import get_rendezvous_handler

from vibraverse.contract import products
from vibraverse.contract.errors import ChildFailed, NotStored, NotThere, UsageError
from vibraverse.learn import rank
from vibraverse.learn.assignment import Assignment
from vibraverse.learn.interruption import SIGNALS, Interrupted
from vibraverse.learn.ranks import choose
from vibraverse.learn.train import Trained

#: Environment variable with the signals for which the agent sets its own handlers, and one that nobody sends.
_HANDLED, _NONE = "TORCHELASTIC_SIGNALS_TO_HANDLE", "SIGQUIT"
_ERRORS = {kind.__name__: kind for kind in (NotStored, NotThere, UsageError)}


def train_together(assignment: Assignment, processes: int, folder: Path) -> tuple[Trained, dict]:
    """Train in several processes; return and raise what :meth:`Assignment.train` does.

    ``folder`` is emptied. Raises :class:`NotThere` too if the system kills one of the processes. This process itself
    uses no GPU.
    """
    choose(assignment.device, processes - 1)  # said before any process starts
    products.remove(folder)
    folder.mkdir(parents=True)
    products.write_json(folder / rank.ASSIGNMENT, asdict(assignment))
    agent = _agent(processes, folder)
    with _signals_passed_on(agent) as caught:
        result = agent.run()
    if not (folder / rank.TRAINED).is_file():
        raise _error(result, processes, folder, caught)
    found = torch.load(folder / rank.TRAINED, weights_only=True, map_location="cpu")
    return Trained(**found["trained"]), found["about"]


def _agent(processes: int, folder: Path) -> LocalElasticAgent:
    """Return the agent, as ``torchrun`` makes it."""
    meeting = RendezvousParameters(
        "c10d", "localhost:0", uuid.uuid4().hex, min_nodes=1, max_nodes=1, local_addr="localhost"
    )
    spec = WorkerSpec(
        role="train",
        local_world_size=processes,
        rdzv_handler=get_rendezvous_handler(meeting),
        entrypoint=sys.executable,
        args=("-m", rank.__name__, str(folder), str(os.getpid())),
        max_restarts=0,
        monitor_interval=0.1,
        local_addr="localhost",
    )
    return LocalElasticAgent(spec, DefaultLogsSpecs(log_dir=str(folder / "agent")))


@contextmanager
def _signals_passed_on(agent: LocalElasticAgent) -> Iterator[list[str]]:
    """Pass :data:`SIGNALS` on to the processes; yield the list of those that came.

    A signal that comes before the processes have started raises :class:`Interrupted`.
    """
    caught: list[str] = []

    def pass_on(number: int, frame) -> None:
        caught.append(signal.Signals(number).name)
        started = [worker.id for worker in agent.get_worker_group().workers]
        if None in started:
            raise _too_early(caught)
        for process in started:
            with suppress(ProcessLookupError):
                os.kill(process, number)

    handled = os.environ.get(_HANDLED)
    os.environ[_HANDLED] = _NONE
    before = {number: signal.signal(number, pass_on) for number in SIGNALS}
    try:
        yield caught
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        os.environ.pop(_HANDLED)
        if handled is not None:
            os.environ[_HANDLED] = handled


def _error(result: RunResult, processes: int, folder: Path, caught: list[str]) -> Exception:
    """Return what ended a training: what a process said, a signal, or how a process died."""
    for number in range(processes):
        path = folder / rank.ERROR.format(rank=number)
        if path.is_file():
            said = products.read_json(path)
            if said["kind"] == Interrupted.__name__:
                return Interrupted(said["message"], said["step"])
            return _ERRORS.get(said["kind"], NotThere)(said["message"])
    # The agent ends with SIGTERM what a dead process leaves.
    for number, failure in sorted(result.failures.items()):
        if failure.exitcode < 0 and -failure.exitcode != signal.SIGTERM:
            name = signal.Signals(-failure.exitcode).name
            why = ", probably for lack of memory" if -failure.exitcode == signal.SIGKILL else ""
            return NotThere(
                f"process {number + 1} of the {processes} that trained together was killed ({name}){why}; ask for more "
                "memory, or lower training.workers or training.batch_size, then repeat the command, which goes on from "
                "the newest checkpoint"
            )
    if caught:
        return _too_early(caught)
    failed = ", ".join(str(number + 1) for number in sorted(result.failures))
    return ChildFailed(
        f"process {failed} of the {processes} that trained together failed; its error stands above"
    )


def _too_early(caught: list[str]) -> Interrupted:
    return Interrupted(
        f"{caught[0]} ended training before its first step; the same command starts it again", 0
    )
