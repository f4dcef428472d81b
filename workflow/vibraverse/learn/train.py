"""The trainer: one loop for every task, which survives kills and repeats itself exactly.

The order of samples and everything random follow from the seed and the step, so a checkpoint holds no state of random
generators: each step seeds them anew. Half a training and its continuation give what an unbroken one gives.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass, field
from pathlib import Path

import torch

from vibraverse.config.training import Training
from vibraverse.contract import products
from vibraverse.contract.errors import UsageError
from vibraverse.contract.texts import and_more
from vibraverse.learn import evaluation, hardware, optimisation, order, precision
from vibraverse.learn.checkpoint import Checkpoints
from vibraverse.learn.curves import Curves, means
from vibraverse.learn.interruption import Interrupted, Signals
from vibraverse.learn.progress import Progress
from vibraverse.learn.ranks import Ranks, joined
from vibraverse.learn.task import Task

#: Options that leave the result of a number of steps as it is; they may change between attempts.
_FREE = {"minutes", "checkpoint_minutes", "workers"}
#: Samples of a batch that a message names.
_SHOWN_SAMPLES = 16


@dataclass(frozen=True)
class Trained:
    """A trained network: weights after the last step and at the best validation (on the CPU), metrics, curves."""

    model: dict[str, torch.Tensor]
    best: dict[str, torch.Tensor]
    metrics: dict
    curves: list[dict]


@dataclass
class State:
    """What a checkpoint keeps besides weights, optimiser and curves; ``seconds`` are over all attempts."""

    step: int = 0
    validated: int = -1
    seconds: float = 0.0
    validation: dict[str, float] = field(default_factory=dict)
    best_step: int = 0
    best_value: float = math.inf
    best_validation: dict[str, float] = field(default_factory=dict)


def train(
    task: Task,
    options: Training,
    work: str | Path,
    *,
    seed: int,
    facts: Mapping,
    device: str | torch.device | None = None,
    say: Callable[[str], None] = print,
) -> Trained:
    """Train a task's network; go on from the newest checkpoint in ``work``.

    ``facts`` names what makes this training what it is: resolved configuration, checksum of the data, versions. The
    options (but for limits and workers) and the seed are added to it. ``device``: see
    :func:`~vibraverse.learn.ranks.joined`. ``say`` receives lines for people.

    Raises :class:`Interrupted` after SIGTERM or SIGUSR1, once a checkpoint is written; :class:`UsageError` for a
    checkpoint of other facts, an unusable split or batch, and a loss that is not finite; :class:`NotStored` if a
    checkpoint cannot be written; :class:`NotThere` without the GPU asked for.
    """
    with ExitStack() as stack:
        ranks = stack.enter_context(joined(device))
        arithmetic = precision.resolve(options.precision, ranks.device)
        stack.enter_context(precision.tf32(arithmetic == "bf16"))
        everything = {**facts, "training": options.model_dump(mode="json", exclude=_FREE), "seed": seed}
        checkpoints = Checkpoints(Path(work), everything, hardware.versions())
        run = _Run(task, options, seed, ranks, checkpoints, say if ranks.first else lambda line: None)
        # Not earlier: a process that only starts may end at once, and must not wait for others that did.
        run.signals = stack.enter_context(Signals())
        return run.train()


class _Run:
    """One attempt at a training, in one of its processes."""

    def __init__(
        self,
        task: Task,
        options: Training,
        seed: int,
        ranks: Ranks,
        checkpoints: Checkpoints,
        say: Callable[[str], None],
    ):
        self.task, self.options, self.seed, self.ranks = task, options, seed, ranks
        self.checkpoints, self.say, self.signals = checkpoints, say, Signals()
        self.precision = precision.resolve(options.precision, ranks.device)
        self.data = evaluation.samples(task, "train")
        self.validation_data = evaluation.samples(task, "validation")
        _check_batch(options.batch_size, len(self.data), ranks.count)

        evaluation.seed_all(order.named_seed(seed, "model"), ranks.device)
        self.model = optimisation.placed(task.model(), options, ranks)
        self.optimiser = optimisation.optimiser(self.model, options)
        self.state, self.curves, self.best = State(), Curves(options.steps), {}
        self._resume()
        self.attempts = ranks.lead(self._count_attempt)
        self.shared = optimisation.shared(self.model, ranks)
        self.progress = Progress(say, self.state.step, options.steps)
        self._before, self._began, self._saved = self.state.seconds, time.monotonic(), time.monotonic()

    def train(self) -> Trained:
        """Take the steps that are left, and validate what they reach."""
        keys = order.StepKeys(self.seed, self.state.step, self.options.steps, *self._place())
        try:
            with closing(evaluation.batches(self.task, self.data, keys, self.options, self.ranks)) as batches:
                self._take_steps(batches)  # closing it ends the data workers, whatever happens
            self._validate()
            return self._trained()
        finally:
            self.shared = self.model  # the wrapper must not outlive the group of processes, see ranks.py

    def _take_steps(self, batches: Iterator) -> None:
        state = self.state
        late = bool(self.ranks.total(self._late())[0])
        while state.step < self.options.steps and not late:
            if self._due():
                self._validate()  # a signal came between the step and its validation
            late, stop, save = self._step(batches)
            if stop:
                self._interrupt()
            if late or self._due():
                self._validate()
            if save or late or state.step == self.options.steps:
                self._save()

    def _place(self) -> tuple[int, int, int, int]:
        return len(self.data), self.options.batch_size, self.ranks.rank, self.ranks.count

    def _step(self, batches: Iterator) -> tuple[bool, bool, bool]:
        """Take one step; return whether the time is up, a signal came, and a checkpoint is due, in any process."""
        step, share = self.state.step, self.options.batch_size // self.ranks.count
        began = time.perf_counter()
        batch = next(batches)
        waited = time.perf_counter() - began
        evaluation.seed_all(order.step_seed(self.seed, step, self.ranks.rank), self.ranks.device)
        rate = optimisation.learning_rate(self.options, step)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        self.shared.train()
        self.optimiser.zero_grad()
        batch = self.task.prepare(batch, self.ranks.device)
        with precision.autocast(self.precision, self.ranks.device):
            losses = self.task.losses(self.shared, batch)
        if losses.shape != (share,):
            raise TypeError(
                f"{type(self.task).__name__}.losses returned the shape {tuple(losses.shape)}, not ({share},): one "
                "loss for each sample"
            )
        losses = losses.float()
        losses.mean().backward()
        limit = self.options.clip_norm or math.inf
        norm = float(torch.nn.utils.clip_grad_norm_(self.model.parameters(), limit))
        # One exchange per step, and the only wait for the GPU: a wrong loss must not reach the weights.
        loss, late, stop, save = self.ranks.total(
            float(losses.detach().mean()) / self.ranks.count,
            self._late(),
            bool(self.signals.caught),
            self.ranks.first and self._save_due(),
        )
        if not (math.isfinite(loss) and math.isfinite(norm)):
            self._not_finite(losses.detach(), norm)
        self.optimiser.step()
        self.state.step = step + 1
        seconds = time.perf_counter() - began
        self.curves.add(step + 1, rate, loss, norm, self.options.batch_size, seconds, waited)
        self.progress.stepped(step + 1, loss, rate, means(self.curves.total))
        return bool(late), bool(stop), bool(save)

    def _not_finite(self, losses: torch.Tensor, norm: float) -> None:
        """Raise the error that names the samples whose loss is not a number, or those of the whole batch."""
        step = self.state.step
        keys = order.step_keys(self.seed, step, *self._place())
        named = list(evaluation.names(self.task, "train", keys))
        wrong = [name for name, loss in zip(named, losses.tolist(), strict=True) if not math.isfinite(loss)]
        found = self.ranks.gather((wrong, named))
        wrong = [name for part, _ in found for name in part]
        shown = wrong or [name for _, part in found for name in part]
        what = "the loss of some samples" if wrong else f"the norm of the gradient, {norm}, of these samples"
        shown = [*shown[:_SHOWN_SAMPLES], *and_more(len(shown), _SHOWN_SAMPLES)]
        raise UsageError(
            f"step {step + 1}: {what} is not a finite number: {', '.join(shown)}; look at these samples, or lower "
            f"learning_rate ({self.options.learning_rate:g}) or clip_norm ({self.options.clip_norm})"
        )

    def _due(self) -> bool:
        """Return whether a validation belongs after the last step."""
        every, step = self.options.validate_every, self.state.step
        return step == self.options.steps or (step > 0 and every > 0 and step % every == 0)

    def _validate(self) -> None:
        """Compute the validation's metrics, once per step, and keep the weights if they are the best."""
        state = self.state
        if state.validated == state.step:
            return
        found = evaluation.predictions(
            self.task,
            self.model,
            "validation",
            self.options,
            self.ranks,
            seed=self.seed,
            data=self.validation_data,
            pause=self._pause,
        )
        state.validation = {name: float(value) for name, value in self.task.score(found).items()}
        state.validated, value = state.step, state.validation[self.task.best]
        better = value < state.best_value or not self.best
        if better:
            state.best_value = value if math.isfinite(value) else math.inf
            state.best_step, state.best_validation = state.step, state.validation
            self.best = _copy(self.model.state_dict())
        self.curves.validated(value)
        self.progress.validated(state.step, self.task.best, value, better)

    def _pause(self) -> None:
        """Stop a long validation for a signal. Several processes finish it, for they cannot agree between batches."""
        if self.signals.caught and self.ranks.count == 1:
            self._interrupt()

    def _interrupt(self) -> None:
        """Write a checkpoint and raise :class:`Interrupted`."""
        self._save()
        name = next(filter(None, self.ranks.gather(self.signals.caught)))
        raise Interrupted(
            f"{name} ended training after step {self.state.step} of {self.options.steps}; a checkpoint is in "
            f"{self.checkpoints.folder}, and the same command goes on from it",
            self.state.step,
        )

    def _late(self) -> bool:
        """Return whether the wall-clock limit is reached; the first process's clock decides."""
        limit = self.options.minutes
        return self.ranks.first and limit is not None and self._seconds() >= 60 * limit

    def _save_due(self) -> bool:
        return time.monotonic() - self._saved >= 60 * self.options.checkpoint_minutes

    def _seconds(self) -> float:
        """Return the time of training so far, over all attempts."""
        return self._before + time.monotonic() - self._began

    def _save(self) -> None:
        self.state.seconds = self._seconds()
        self.ranks.lead(self._write)
        self._saved = time.monotonic()

    def _write(self) -> None:
        content = {
            "model": self.model.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "best": self.best,
            "state": asdict(self.state),
            "curves": self.curves.state(),
        }
        self.checkpoints.save(self.state.step, content)

    def _resume(self) -> None:
        """Take over the newest checkpoint, if there is one."""
        step = self.ranks.lead(lambda: self.checkpoints.newest(self.say))
        if step is None:
            return
        content = self.checkpoints.load(step)
        self.model.load_state_dict(content["model"])
        self.optimiser.load_state_dict(content["optimiser"])
        self.best, self.state = content["best"], State(**content["state"])
        self.curves.restore(content["curves"])
        self.say(f"training goes on after step {step} of {self.options.steps} ({self.checkpoints.folder})")

    def _count_attempt(self) -> int:
        """Note that an attempt begins, so that kills are counted too; return the number of attempts."""
        path = self.checkpoints.folder / "attempts"
        with products.storing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            with open(path, "a+", encoding="utf-8") as file:
                file.write("begun\n")
                file.seek(0)
                return len(file.readlines())

    def _trained(self) -> Trained:
        state, total = self.state, self.curves.total
        metrics = {
            "ended": "steps" if state.step == self.options.steps else "minutes",
            "steps": state.step,
            "epochs": state.step * self.options.batch_size / len(self.data),
            "samples": {"train": len(self.data), "batch": self.options.batch_size},
            "loss": self.curves.rows[-1]["loss"] if self.curves.rows else None,
            "validation": state.validation,
            "best": {"step": state.best_step, "metric": self.task.best, "validation": state.best_validation},
            "parameters": sum(weight.numel() for weight in self.model.parameters()),
            "seconds": self._seconds(),
            "samples_per_s": means(total)["samples_per_s"],
            "waiting_share": means(total)["waiting_share"],
            "interruptions": self.attempts - 1,
            "seed": self.seed,
            "precision": self.precision,
            "tf32": self.ranks.device.type == "cuda" and torch.backends.cuda.matmul.allow_tf32,
            "processes": self.ranks.count,
            "hardware": hardware.describe(self.ranks.device),
            "versions": hardware.versions(),
        }
        return Trained(_copy(self.model.state_dict()), self.best, metrics, self.curves.rows)


def _check_batch(batch: int, count: int, processes: int) -> None:
    """Raise :class:`UsageError` if batches of this size cannot be made of the samples."""
    if batch > count:
        raise UsageError(
            f"batch_size is {batch}, but the split 'train' has {count} sample{'s' * (count != 1)}; lower batch_size to "
            f"{count} or less, or add objects"
        )
    if batch % processes:
        raise UsageError(
            f"batch_size is {batch}, which {processes} processes cannot share equally; make it a multiple of "
            f"{processes}"
        )


def _copy(weights: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Return weights as tensors of their own on the CPU."""
    return {name: weight.detach().to("cpu", copy=True) for name, weight in weights.items()}
