"""What answers are worth: measures by side, by what bodies have in common, with intervals.

A row holds ``side``, ``source`` (what the bodies have in common; "all" for all of them), ``measure``, ``value``, and
where there is an interval ``low`` and ``high``; ``count`` is the number of bodies.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.interpolate import interp1d

from vibraverse.geometry import LONGEST_SIDE
from vibraverse.learn.metrics import LOWEST, bootstrap, frequency_errors, wilson
from vibraverse.learn.samples import Samples
from vibraverse.learn.scaling import scaled
from vibraverse.learn.sides import HELD_OUT, TEST
from vibraverse.sources.families import GROUPS

#: Bounds of the thickness t by which bodies are looked at.
THICKNESS = (0.3, 0.4, 0.5, 0.6, 0.7)
#: Error of t within which a wall's thickness counts as found.
WALL = 0.05
#: Measures of reconstructions, and how those of bodies are joined.
RECONSTRUCTION: dict[str, Callable] = {
    "iou": np.mean,
    "band_error": np.mean,
    "distance_error": np.mean,
    "volume_error": np.median,
    "chamfer": np.median,
    "f_1%": np.mean,
    "f_2%": np.mean,
    "normals": np.mean,
    "empty": np.mean,
    "frequency_error": np.median,
    "failed": np.mean,
    "seconds": np.mean,
}


@dataclass
class Judgement:
    """Answers on all tested sides as ``side/name``, the rows of their measures, and which bodies were judged rightly.

    ``right`` maps a side to body -> bool, for tasks whose answers are right or wrong.
    """

    answers: dict[str, np.ndarray] = field(default_factory=dict)
    rows: list[dict] = field(default_factory=list)
    right: dict[str, dict[str, bool]] = field(default_factory=dict)


def judged(task, answers: Callable[[str], dict[str, np.ndarray]]) -> Judgement:
    """Return the judgement of a model; ``answers(side)`` returns what the task's ``judge`` takes.

    Sides without bodies are left out.
    """
    found = Judgement()
    for side in (TEST, HELD_OUT):
        bodies = task.sides[side]
        if len(bodies):
            said, names = answers(side), [task.samples.ids[body] for body in bodies]
            found.answers |= {f"{side}/{name}": values for name, values in said.items()}
            found.answers[f"{side}/body"] = np.array(names)
            found.rows += [{"side": side, **row} for row in task.judge(bodies, said)]
            right = task.right(bodies, said)
            if right is not None:
                found.right[side] = dict(zip(names, right.tolist(), strict=True))
    return found


def judge_frequencies(samples: Samples, bodies: np.ndarray, found_hz: np.ndarray) -> list[dict]:
    """Return the rows of frequencies (n, materials, m) in Hz of bodies (n,) in all named materials."""
    rows = []
    true_hz = samples.rows("frequencies_hz", bodies)
    for source, mask in _sources(samples, bodies).items():
        shape = (-1, found_hz.shape[-1])
        found, true = np.maximum(found_hz[mask].reshape(shape), LOWEST), true_hz[mask].reshape(shape)
        measures = frequency_errors(found, true)
        measures["scaled_mse"] = float(np.square(scaled(found) - scaled(true)).mean())
        objects = np.repeat(samples.object[bodies[mask]], found_hz.shape[1])
        low, high = bootstrap(np.abs(found / true - 1.0), objects)
        for name, value in measures.items():
            interval = {"low": low, "high": high} if name == "median" else {}
            rows.append(
                {"source": source, "measure": name, "value": value, "count": int(mask.sum()), **interval}
            )
    return rows


def judge_solidity(samples: Samples, bodies: np.ndarray, right: np.ndarray) -> list[dict]:
    """Return the rows of bodies (n,) of which some were judged rightly (n,)."""
    rows = []
    for source, mask in _sources(samples, bodies).items():
        hits, count = int(right[mask].sum()), int(mask.sum())
        low, high = wilson(hits, count)
        about = {"source": source, "measure": "accuracy", "count": count}
        rows.append({**about, "value": hits / count, "low": low, "high": high})
    return rows


def judge_reconstruction(
    samples: Samples, bodies: np.ndarray, poisson: np.ndarray, answers: dict[str, np.ndarray]
) -> list[dict]:
    """Return the rows of reconstructed bodies (n,), see :mod:`vibraverse.learn.reconstructions`.

    Frequencies at Poisson's ratios (n,) are compared with those of the true surface by the same method. A surface that
    no solid can have counts as wrong by 100 %.
    """
    failed = np.isnan(answers["log_omega"]).any(axis=1)
    true = np.stack([_splines(samples, *one) for one in zip(bodies, poisson, strict=True)])
    wrong = np.where(failed, 1.0, np.median(np.abs(np.expm1(answers["log_omega"] - true)), axis=1))
    values = {
        **{name: answers[name] for name in RECONSTRUCTION if name in answers},
        "frequency_error": np.minimum(wrong, 1.0),
        "failed": failed.astype(float),
    }
    rows = []
    for source, mask in _sources(samples, bodies).items():
        for name, statistic in RECONSTRUCTION.items():
            known = mask & np.isfinite(values[name])  # there is no Chamfer distance without a surface
            if known.any():
                found, objects = values[name][known], samples.object[bodies[known]]
                interval = {}
                if source in ("all", "solid", "hollow"):
                    interval = dict(zip(("low", "high"), bootstrap(found, objects, statistic), strict=True))
                about = {"source": source, "measure": name, "count": int(known.sum())}
                rows.append({**about, "value": float(statistic(found)), **interval})
    return rows


def judge_thickness(samples: Samples, bodies: np.ndarray, found: np.ndarray) -> list[dict]:
    """Return the rows of thicknesses t (n,) that were found for hollow bodies (n,)."""
    error = np.abs(found - samples.rows("thickness", bodies))
    rows = []
    for source, mask in _sources(samples, bodies).items():
        low, high = bootstrap(error[mask], samples.object[bodies[mask]], np.mean)
        about = {"source": source, "count": int(mask.sum())}
        rows += [
            {**about, "measure": "t_error", "value": float(error[mask].mean()), "low": low, "high": high},
            {**about, "measure": f"t_within_{WALL:g}", "value": float((error[mask] <= WALL).mean())},
        ]
    return rows


def _splines(samples: Samples, body: int, poisson: float) -> np.ndarray:
    """Return the logarithms of ω (m,) of a body for E = ρ = 1 in normalised lengths, by the fewest splines."""
    rows = samples.row("ritz", body)[:, len(samples.ritz_degrees)].astype(float)
    volume = float(samples.row("volume_m3", body)) * (LONGEST_SIDE / float(samples.row("size_m", body))) ** 3
    return interp1d(samples.poisson, rows, axis=0, fill_value="extrapolate")(poisson) - np.log(volume) / 3


def _sources(samples: Samples, bodies: np.ndarray) -> dict[str, np.ndarray]:
    """Return masks (n,) of bodies that have something in common.

    All of them; an origin, a group of families, a solidity, a thickness.
    The thickness of an object is that of its hollow body.
    """
    origin, solidity, object_ = samples.origin[bodies], samples.solidity[bodies], samples.object[bodies]
    own = samples.rows("thickness", bodies)
    of_object = {name: t for name, t in zip(object_, own, strict=True) if not np.isnan(t)}
    thickness = np.array([of_object.get(name, np.nan) for name in object_])
    masks = {"all": np.ones(len(bodies), dtype=bool)}
    masks |= {f"origin {name}": origin == name for name in sorted(set(origin))}
    families = samples.family[bodies]
    masks |= {
        name: (origin == "generated") & np.isin(families, GROUPS[name])
        for name in ("parametric", "open-ended")
    }
    masks |= {name: solidity == name for name in ("solid", "hollow")}
    masks |= {
        f"t {low:g}-{high:g}": (thickness >= low) & (thickness < high) for low, high in pairwise(THICKNESS)
    }
    return {name: mask for name, mask in masks.items() if mask.any()}
