"""Training survives signals and kills, and continues as if nothing had happened."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from toy_task import INTERRUPTED, Toy, at_event, in_processes, run, same  # noqa: E402

from vibraverse.contract.errors import NotThere  # noqa: E402
from vibraverse.learn.interruption import Interrupted, Signals  # noqa: E402

pytestmark = pytest.mark.learn

MOMENTS = 10


def toy() -> Toy:
    return Toy(dropout=0.2)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """An unbroken training, and the number of events in it: calls of the network, flushes, renames."""
    folder, task = tmp_path_factory.mktemp("whole"), toy()
    with at_event(0, lambda: None, task) as seen:
        trained = run(folder, task)
    assert seen[0] > 50
    return trained, seen[0]


def ended_at(folder: Path, number: int, by: signal.Signals) -> int:
    """Train in a process that gets a signal at an event; return its exit status."""

    def work(rank):
        task = toy()
        with at_event(number, lambda: os.kill(os.getpid(), by), task):
            run(folder, task)

    return in_processes(work)[0]


@pytest.mark.parametrize("by", [signal.SIGKILL, signal.SIGTERM])
@pytest.mark.parametrize("moment", range(MOMENTS))
def test_training_goes_on_after(tmp_path, whole, by, moment):
    """Moments are spread over the whole, so they fall into steps, validations, and the writing of checkpoints."""
    trained, events = whole
    number = 1 + (events - 1) * moment // MOMENTS + moment % 3
    status = ended_at(tmp_path, number, by)
    assert status == (-signal.SIGKILL if by == signal.SIGKILL else INTERRUPTED)
    again = run(tmp_path, toy())
    same(trained, again)
    assert again.metrics["interruptions"] == 1
    assert not list(tmp_path.glob(".*"))


def test_training_goes_on_after_many_kills(tmp_path, whole):
    trained, _ = whole
    kills = 0
    while (status := ended_at(tmp_path, 17, signal.SIGKILL)) == -signal.SIGKILL:
        kills += 1
    assert status == 0
    assert kills > 3
    again = run(tmp_path, toy())
    same(trained, again)
    assert again.metrics["interruptions"] == kills + 1


@pytest.mark.parametrize("name", ["SIGTERM", "SIGUSR1"])
def test_a_signal_ends_training_after_its_step(tmp_path, whole, name):
    task, calls = toy(), [0]

    def at_losses():
        calls[0] += 1
        if calls[0] == 5:
            os.kill(os.getpid(), getattr(signal, name))

    task.at_losses = at_losses
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(Interrupted) as ended:
        run(tmp_path, task, checkpoint_minutes=9)
    assert ended.value.step == 5
    assert isinstance(ended.value, NotThere)
    assert str(ended.value) == (
        f"{name} ended training after step 5 of 24; a checkpoint is in {tmp_path}, and the same command goes on from it"
    )
    assert [path.name for path in tmp_path.glob("step-*")] == ["step-00000005"]
    assert signal.getsignal(signal.SIGTERM) == before
    said = []
    same(whole[0], run(tmp_path, toy(), checkpoint_minutes=9, say=said.append))
    assert said[0] == f"training goes on after step 5 of 24 ({tmp_path})"


def test_a_signal_ends_a_long_validation(tmp_path, whole):
    class Long(Toy):
        def predict(self, model, batch):
            os.kill(os.getpid(), signal.SIGTERM)
            return super().predict(model, batch)

    with pytest.raises(Interrupted) as ended:
        run(tmp_path, Long(dropout=0.2))
    assert ended.value.step == 7
    same(whole[0], run(tmp_path, toy()))


def test_processes_agree_on_a_signal_to_one(tmp_path):
    whole = run(tmp_path / "whole")

    def work(rank):
        task = Toy()
        if rank == 1:
            calls = iter(range(1, 100))
            task.at_losses = lambda: next(calls) == 5 and os.kill(os.getpid(), signal.SIGTERM)
        run(tmp_path / "two", task, checkpoint_minutes=9)

    assert in_processes(work, 2, group=True) == [INTERRUPTED, INTERRUPTED]
    assert [path.name for path in (tmp_path / "two").glob("step-*")] == ["step-00000005"]

    def rest(rank):
        trained = run(tmp_path / "two")
        assert trained.metrics["loss"] == pytest.approx(whole.metrics["loss"], abs=1e-5)

    assert in_processes(rest, 2, group=True) == [0, 0]


def test_one_process_goes_on_for_two(tmp_path):
    whole = run(tmp_path / "whole")
    steps = iter(range(1, 100))

    def work(rank):
        task = Toy()
        task.at_losses = lambda: next(steps) == 9 and os.kill(os.getpid(), signal.SIGTERM)
        run(tmp_path / "two", task)

    assert in_processes(work, 2, group=True) == [INTERRUPTED, INTERRUPTED]
    trained = run(tmp_path / "two")
    assert trained.metrics["validation"]["squared_error"] == pytest.approx(
        whole.metrics["validation"]["squared_error"], abs=1e-5
    )


SCRIPT = """
import sys, time
from pathlib import Path
from toy_task import INTERRUPTED, Toy, run
from vibraverse.learn.interruption import Interrupted

class Slow(Toy):
    def losses(self, model, batch):
        time.sleep(0.02)
        return super().losses(model, batch)

try:
    say = lambda line: print(line, flush=True)
    run(Path(sys.argv[1]), Slow(), workers=2, steps=10_000, checkpoint_minutes=9, say=say)
except Interrupted as interrupted:
    print(interrupted.step)
    sys.exit(INTERRUPTED)
"""


def test_a_scheduler_signals_all_processes_at_once(tmp_path):
    """Data workers get the signal, too, and must not take the last step with them."""
    path = os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])
    child = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, tmp_path],
        env={**os.environ, "PYTHONPATH": path},
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    # A validation comes after step 7 and says so.
    assert "step 7 of" in child.stdout.readline()
    os.killpg(child.pid, signal.SIGTERM)
    out, err = child.communicate(timeout=60)
    assert child.returncode == INTERRUPTED, err
    assert (tmp_path / f"step-{int(out.split()[-1]):08d}").is_dir()
    with pytest.raises(ProcessLookupError):
        os.killpg(child.pid, 0)


def test_signals_keep_their_handlers_outside_of_training():
    heard = []
    before = signal.signal(signal.SIGUSR1, lambda number, frame: heard.append(number))
    try:
        with Signals() as signals:
            os.kill(os.getpid(), signal.SIGUSR1)
            assert signals.caught == "SIGUSR1"
        os.kill(os.getpid(), signal.SIGUSR1)
        assert heard == [signal.SIGUSR1]
    finally:
        signal.signal(signal.SIGUSR1, before)
