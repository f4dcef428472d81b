"""What benchmarks/gpu.py measures: each part yields what it has found so far."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

#: Largest relative difference of labels.
_EXACT = 1e-9


@dataclass(frozen=True)
class Setting:
    """What every part gets; ``seconds`` is the time that it should take."""

    device: str
    preset: str
    features: Path
    work: Path
    seconds: float
    threads: int

    @property
    def small(self) -> bool:
        """Whether this is a trial of the benchmark itself."""
        return self.preset == "tiny"


def data(setting: Setting, objects: int) -> Iterator[dict]:
    """Invent bodies."""
    import synthetic

    from vibraverse.config.learn import Features

    began = time.perf_counter()
    points = 512 if setting.small else 4096
    synthetic.write(setting.features, objects, Features(points=points, view_px=32 if setting.small else 64))
    yield {"bodies": 2 * objects, "seconds": time.perf_counter() - began}


def labels(setting: Setting) -> Iterator[dict]:
    """Measure exact spectra in batches on the device, and one by one on the CPU, which must be the same."""
    import numpy as np
    import torch

    from vibraverse.contract.seeds import rng
    from vibraverse.learn.labels import operators, spectra
    from vibraverse.physics.basis import build_basis
    from vibraverse.physics.modes import solve_material

    torch.set_num_threads(1)
    modes, cells = (10, (8, 4, 3)) if setting.small else (64, (12, 8, 6))
    bases = [
        build_basis(*_box(sides, cells), rng=rng(str(sides)), order=1, modes=modes, max_error=1e-4)
        for sides in ((1.8, 0.5, 0.4), (1.8, 1.2, 0.3), (1.0, 1.0, 1.0), (1.8, 1.5, 1.0))
    ]
    count = 64 if setting.small else 512
    batch = operators(bases).to(setting.device)[torch.arange(count, device=setting.device) % len(bases)]
    ratios = torch.linspace(0.1, 0.4, count, dtype=torch.float64, device=setting.device)
    found = spectra(batch, ratios, modes).cpu().numpy()

    began, solved, worst = time.perf_counter(), 0, 0.0
    while solved < count and time.perf_counter() - began < setting.seconds / 3:
        basis = bases[solved % len(bases)]
        material = {"young_pa": 1.0, "density_kg_m3": 1.0, "poisson": float(ratios[solved])}
        one = solve_material(basis, {**material, "alpha_per_s": 0, "beta_s": 0}, 1.0, modes)
        expected = one.frequencies_hz * 2 * np.pi * np.cbrt(basis.volume)
        worst = max(worst, float(np.abs(found[solved] / expected - 1).max()))
        solved += 1
    cpu = solved / (time.perf_counter() - began)
    yield {
        "rows": batch.a_mu.shape[-1], "modes": modes, "batch": count, "compared": solved, "cpu_per_s": cpu,
        "difference": worst, "exact": worst < _EXACT,
    }  # fmt: skip

    began, done = time.perf_counter(), 0
    while time.perf_counter() - began < setting.seconds / 3:
        spectra(batch, ratios, modes).cpu()  # which waits for the device
        done += count
    yield {"device_per_s": done / (time.perf_counter() - began)}


def lobpcg(setting: Setting) -> Iterator[dict]:
    """Measure LOBPCG on the device and on the CPU, against the workflow's eigensolver."""
    import numpy as np
    import torch

    from vibraverse.contract.seeds import rng
    from vibraverse.learn.baselines import lobpcg as iterations
    from vibraverse.learn.baselines.starts import random
    from vibraverse.physics.eigensolver import solve
    from vibraverse.physics.elasticity import assemble

    torch.set_num_threads(1)
    modes, cells = (10, (6, 3, 2)) if setting.small else (64, (12, 8, 6))
    operators = assemble(*_box((1.8, 1.2, 0.9), cells), 2)
    material = {"young_pa": 1.0, "density_kg_m3": 1.0, "poisson": 0.3}
    start = random(operators, modes + iterations.GUARD, rng("start"))

    def run(device: str, **limits):
        return iterations.frequencies(
            operators, start, material, 1.0, modes=modes, preconditioner="jacobi", device=device, **limits
        )[1]

    run(setting.device, max_iterations=2)  # loads the device's libraries
    found = run(setting.device, tolerance=1e-3, max_iterations=500)
    yield {
        "unknowns": operators.unknowns, "modes": modes, "iterations": found.iterations, "converged": found.converged,
        "device_s": found.wall_seconds, "device_ms_per_iteration": 1000 * found.wall_seconds / found.iterations,
    }  # fmt: skip
    few = run("cpu", max_iterations=5)
    yield {"cpu_ms_per_iteration": 1000 * few.wall_seconds / few.iterations}
    began = time.perf_counter()
    expected = solve(operators, 0.3, modes, rng=rng("solve"), tolerance=1e-3).values
    yield {
        "eigensolver_cpu_s": time.perf_counter() - began,
        "difference": float(np.abs(np.sqrt(found.values / expected) - 1).max()),
    }


def training(name: str, model: str) -> Callable[[Setting], Iterator[dict]]:
    """Return the part that trains a model for its time."""

    def part(setting: Setting) -> Iterator[dict]:
        import synthetic
        import torch

        from vibraverse.learn.train import train

        torch.set_num_threads(setting.threads)
        task = synthetic.task(setting.features, name, model, setting.preset, minutes=setting.seconds / 60)
        work = setting.work / f"{name}-{model}-{os.getpid()}"
        trained = train(
            task, task.options.training, work, seed=0, facts={}, device=setting.device, say=lambda line: None
        )
        # Kernels are compiled and chosen in the first steps.
        later = trained.curves[len(trained.curves) // 2 :]
        keys = ("steps", "seconds", "loss", "waiting_share", "precision", "parameters", "samples")
        yield {
            **{key: trained.metrics[key] for key in keys},
            "samples_per_s": sum(row["samples_per_s"] for row in later) / max(len(later), 1),
            "validation": trained.metrics["best"],
            "best_value": trained.metrics["best"]["validation"][task.best],
            "hardware": trained.metrics["hardware"],
            "versions": trained.metrics["versions"],
        }
        if setting.device == "cuda":
            yield {"own_gpu_mb": torch.cuda.max_memory_allocated() / 2**20}

    return part


def loader(setting: Setting) -> Iterator[dict]:
    """Measure the loader alone, by the number of its workers."""
    import synthetic
    from loader import rate

    counts = (0, 2) if setting.small else (0, 4, 8)
    for name in ("frequencies", "solidity"):
        for workers in counts:
            task = synthetic.task(setting.features, name, "published", setting.preset, workers=workers)
            yield {f"{name}, {workers} workers": rate(task, setting.seconds / 8, setting.device)}


def together(setting: Setting) -> Iterator[dict]:
    """Compare two processes, each with a GPU, with one of the same batch."""
    import synthetic
    import torch

    from vibraverse.learn.assignment import Assignment
    from vibraverse.learn.launch import train_together

    if setting.device == "cpu" or torch.cuda.device_count() < 2:
        yield {"left_out": "needs two GPUs"}
        return
    task = synthetic.task(
        setting.features, "solidity", "sound", "tiny", steps=40, learning_rate=1e-4, precision="float32"
    )
    work, features = setting.work / f"together-{os.getpid()}", synthetic.records(setting.features)
    options, splits = task.options.model_dump(mode="json"), setting.features / "splits.tsv"

    alone, both = (
        Assignment(
            [str(one) for one in features], str(splits), options, str(work / name), {}, setting.device, 1
        )
        for name in ("alone", "both")
    )
    (one, _), (two, _) = alone.train(say=lambda line: None), train_together(both, 2, work / "processes")
    difference = max(float((two.model[name] - one.model[name]).abs().max()) for name in one.model)
    losses = abs(two.metrics["loss"] - one.metrics["loss"])
    yield {"difference_of_weights": difference, "difference_of_loss": losses}


def _box(sides: tuple[float, ...], cells: tuple[int, ...]):
    """Return points and positively oriented tetrahedra of a box."""
    import numpy as np
    from skfem import MeshTet

    mesh = MeshTet.init_tensor(
        *(np.linspace(-side / 2, side / 2, count + 1) for side, count in zip(sides, cells, strict=True))
    )
    points, tets = mesh.p.T.copy(), mesh.t.T.copy()
    wrong = np.linalg.det(points[tets[:, 1:]] - points[tets[:, :1]]) < 0
    tets[wrong] = tets[wrong][:, [0, 2, 1, 3]]
    return points, tets
