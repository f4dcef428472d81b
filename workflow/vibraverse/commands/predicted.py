"""What ``vibraverse predict`` says of a body: the numbers in each material, how they compare, how sure they are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import h5py
import numpy as np

from vibraverse.config.learn import FAMILY, OBJECT
from vibraverse.files.modes import read_spectrum
from vibraverse.learn.trained import ErrorBars, TrainedModel
from vibraverse.physics.damping import rayleigh_damping

#: Columns of the table beside the predicted frequency, and where they stand in the facts.
_COLUMNS = {"low": "low_hz", "high": "high_hz", "simulated": "simulated_hz", "error": "relative_error"}
#: Below so many tested bodies the error bars themselves are a guess.
_FEW_BODIES = 20


def row(
    material: Mapping[str, float], volume_m3: float, found_hz: np.ndarray, bars: ErrorBars | None
) -> dict:
    """Return what is predicted of a body in one material."""
    damping, _ = rayleigh_damping(2 * np.pi * found_hz, material["alpha_per_s"], material["beta_s"])
    ends = {} if bars is None else {"low_hz": found_hz * bars.low, "high_hz": found_hz * bars.high}
    return {
        "parameters": dict(material),
        "mass_kg": material["density_kg_m3"] * volume_m3,
        "frequencies_hz": found_hz,
        "damping_per_s": damping,
        **ends,
    }


def simulated(modes: Path, material: str) -> np.ndarray:
    """Return the simulated frequencies (m,) of a material."""
    with h5py.File(modes) as h5:
        return read_spectrum(h5, material)[0]


def compared(row: Mapping, true_hz: np.ndarray) -> dict:
    """Return the simulated frequencies beside predicted ones, and the errors of these."""
    error = row["frequencies_hz"] / true_hz - 1.0
    found = {
        "simulated_hz": true_hz,
        "relative_error": error,
        "median_relative_error": float(np.median(np.abs(error))),
    }
    if "low_hz" in row:
        found["within_error_bars"] = int(((row["low_hz"] <= true_hz) & (true_hz <= row["high_hz"])).sum())
    return found


def about(model: TrainedModel) -> dict:
    """Return what the facts say about a model."""
    return {
        "folder": str(model.folder),
        **{name: getattr(model.options, name) for name in ("model", "split", "seed", "preset")},
        "trained_on_bodies": model.record["bodies"]["train"],
        "sha256": model.sha256,
    }


def bar_warnings(bars: ErrorBars | None) -> list[str]:
    """Return the warnings about how far error bars can be believed."""
    if bars is None:
        return [
            "error bars: none, because the model's folder lacks its answers about unseen bodies; the same `snakemake "
            "learn` writes them"
        ]
    warnings = []
    if bars.split == OBJECT:
        warnings.append(
            "error bars: the tested bodies have siblings among those trained on, so a shape of a new kind has larger "
            "errors; train with `splits: [object, family]` too"
        )
    if bars.bodies < _FEW_BODIES:
        warnings.append(f"error bars: they rest on {bars.bodies} bodies (at least {_FEW_BODIES} are needed)")
    return warnings


def print_facts(facts: dict, stream) -> None:
    """Print a summary, a table for each material, then the warnings."""

    def say(text: str) -> None:
        print(text, file=stream)

    model, bars = facts["model"], facts["error_bars"]
    say(
        f"{facts['mesh']}: {facts['solidity']}, longest side {facts['size_m']:g} m, "
        f"{1e6 * facts['volume_m3']:.4g} cm³"
    )
    say(
        f"model: {model['folder']} ({model['model']}, preset {model['preset']}, trained on "
        f"{model['trained_on_bodies']} bodies)"
    )
    if bars:
        unseen = (
            "of families that their training had not seen" if bars["split"] == FAMILY else "of known families"
        )
        say(
            f"error bars: hold {bars['percent']} % of the frequencies of {bars['bodies']} unseen bodies {unseen}"
        )
    for name, row in facts["materials"].items():
        say(f"\n{name}, {row['mass_kg']:.3g} kg")
        for line in _table(row):
            say(line)
    say("")
    if facts["repairs"]:
        say(f"repaired: {', '.join(facts['repairs'])}")
    for warning in facts["warnings"]:
        say(f"warning: {warning.rstrip('.')}")
    for sound in facts["sounds"].values():
        say(f"wrote {sound['file']} ({sound['duration_s']:.2f} s)")
    say(", ".join(f"{name} {value:.2f} s" for name, value in facts["seconds"].items()))


def _table(row: dict) -> Iterator[str]:
    """Yield the lines of the table of one material."""
    columns = {"Hz": row["frequencies_hz"]}
    columns |= {title: row[key] for title, key in _COLUMNS.items() if key in row}
    yield "mode" + "".join(f"{title:>11}" for title in columns)
    for mode, values in enumerate(zip(*columns.values(), strict=True), 1):
        cells = (
            f"{100 * value:+10.1f}%" if title == "error" else f"{value:11.1f}"
            for title, value in zip(columns, values, strict=True)
        )
        yield f"{mode:4d}" + "".join(cells)
    if "simulated_hz" in row:
        inside = ""
        if "within_error_bars" in row:
            inside = f"; {row['within_error_bars']} of them lie within their error bars"
        median = 100 * row["median_relative_error"]
        yield f"median error of {len(row['simulated_hz'])} modes: {median:.1f} %{inside}"
