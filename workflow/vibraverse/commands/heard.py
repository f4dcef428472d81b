"""The answer of ``vibraverse listen``: as numbers with intervals, and as a text."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.config.physics import Material
from vibraverse.geometry import LONGEST_SIDE
from vibraverse.listening.answer import Answer
from vibraverse.listening.fit import Estimate
from vibraverse.listening.resonances import Lines
from vibraverse.physics.materials import MATERIALS

#: Interval stated for every number, in per cent.
PERCENT = 95
#: Half an interval of Poisson's ratio, and of a logarithm, above which a number is not determined.
_MAX_POISSON, _MAX_LOG = 0.1, 0.2
#: Spread of the frequencies, beyond the errors of peaks and elements, above which a warning says so.
_MAX_SPREAD = 0.006
#: Estimated error of the elements above which it, and not the body, may be why nothing fits.
_MAX_ERROR = 0.02
#: Scatter of log(E/ρ) and of ν among specimens of one material.
_SCATTER_LOG, _SCATTER_POISSON = 0.06, 0.02
#: Verdicts.
FOUND, SEVERAL, FEW, NOTHING = "found", "several answers", "too few peaks", "nothing fits"
#: Peaks that, if they are of another body, match no better than chance; fewer may be of this one.
_MANY = 8


@dataclass(frozen=True)
class Known:
    """What is known about the body beside its shape; None where it is not."""

    size_m: float | None
    material: Material | None
    material_name: str | None
    mass_kg: float | None

    @property
    def speed_m_s(self) -> float | None:
        """``sqrt(E/ρ)`` of a known material."""
        return (
            None
            if self.material is None
            else float(np.sqrt(self.material.young_pa / self.material.density_kg_m3))
        )

    def bounds(self, of_model: np.ndarray, slowest: float, fastest: float, sizes) -> np.ndarray:
        """Return the bounds of ``log s`` and of the model's parameters (1 + q, 2).

        ``slowest`` and ``fastest`` bound ``sqrt(E/ρ)`` in m/s and ``sizes`` the size in m where they are not known.
        """
        speeds = [slowest, fastest] if self.speed_m_s is None else [self.speed_m_s] * 2
        sizes = sizes if self.size_m is None else (self.size_m,) * 2
        bounds = [log_scale(speeds[0], sizes[1]), log_scale(speeds[1], sizes[0])]
        parameters = np.array(of_model)
        if self.material is not None:
            parameters[0] = self.material.poisson
        return np.vstack([bounds, parameters])


def log_scale(speed_m_s: float, size_m: float) -> float:
    """Return ``log s`` in log Hz of a body (see :mod:`vibraverse.listening.resonances`)."""
    return float(np.log(speed_m_s * LONGEST_SIDE / size_m / (2 * np.pi)))


def facts_of(found: Answer, peaks, model, known: Known, volumes: dict[float, float]) -> dict:
    """Return the answer as plain numbers.

    ``volumes`` are those of the solved bodies by wall, in mesh units.
    """
    verdict = _verdict(found)
    estimate = found.estimate
    lines = model.at(estimate.values[1:])
    facts = {
        "verdict": verdict,
        "sentence": _sentence(found, verdict, float(np.median(lines.error))),
        "size_m": known.size_m,
        "known_material": known.material_name,
        "peaks_heard": len(peaks),
        "peaks_among_modes": found.within,
        "peaks_explained": found.explained,
        "spread": estimate.spread,
        "score": found.score,
        "chance": {"mean": found.chance[0], "deviation": found.chance[1]},
        "interval_percent": PERCENT,
        "found": {},
        "not_determined": [],
        "others": [],
        "materials": [],
        "peaks": _peaks(found, peaks, lines),
        "warnings": [],
    }
    if not found.fits:
        return facts
    values, doubts = _values(estimate, known, volumes)
    facts["others"] = [_values(one, known, volumes)[0] for one in found.others]
    if found.damping is not None:
        values |= _damping(found)
    facts["found"], facts["not_determined"] = values, doubts
    facts["materials"] = _materials(values, known)
    if estimate.spread > _MAX_SPREAD:
        facts["warnings"].append(
            f"fit: frequencies are {100 * estimate.spread:.1f} % from those of the mesh "
            f"(at most {100 * _MAX_SPREAD:g} %); the mesh is not quite the body, or its material is not uniform"
        )
    unexplained = found.within - found.explained
    if unexplained > 0.3 * found.within:
        facts["warnings"].append(
            f"fit: {unexplained} of {found.within} peaks are no modes of the body (at most 30 %); a support or the "
            "room may ring too"
        )
    return facts


def _verdict(found: Answer) -> str:
    if found.fits:
        return SEVERAL if found.others else FOUND
    return FEW if found.explains and found.within < _MANY else NOTHING


def _sentence(found: Answer, verdict: str, error: float) -> str:
    """Return the verdict in words. ``error`` is the elements' own in log frequency, the median of the modes."""
    count = f"{found.explained} of {found.within} peaks match modes of the body"
    chance = f"score {found.score:.0f}, by chance {found.chance[0]:.0f} ± {found.chance[1]:.0f}"
    if verdict == FEW:
        return (
            f"Not determined: {count}, but chance would have it so too ({chance}). More peaks would tell: record "
            "nearer, and let the body ring freely."
        )
    if verdict == NOTHING:
        how = "no better than chance would have it" if found.explains else "too few or too far off"
        if error > _MAX_ERROR:
            return (
                f"Nothing fits: {count}, {how} ({chance}). These elements are off by some "
                f"{100 * error:.1f} % (at most {100 * _MAX_ERROR:g} %), which hides any match. Raise --elements, or "
                "use --order 2."
            )
        return (
            f"Nothing fits: {count}, {how} ({chance}). The mesh is not the body that was recorded, or its wall or its "
            "material is not uniform."
        )
    if verdict == SEVERAL:
        return (
            f"Not determined: {count} ({chance}), and {len(found.others)} other answers explain them as well."
        )
    return f"{count} ({chance})"


def _interval(value: float, low: float, high: float) -> dict:
    return {"value": float(value), "low": float(low), "high": float(high)}


def _exponential(log: float, half: float, power: float, unit: float = 1.0) -> dict:
    """Return the interval of ``unit · e^(power · log)``, ascending."""
    ends = sorted(unit * np.exp(power * (log + sign * half)) for sign in (-1, 1))
    return _interval(unit * np.exp(power * log), *ends)


def _values(estimate: Estimate, known: Known, volumes: dict[float, float]) -> tuple[dict, list[str]]:
    """Return what an estimate says, each value with its interval, and sentences about what it does not say."""
    log, half = estimate.values[0], estimate.half_width(0, PERCENT / 100)
    values, doubts = {}, []
    unit = 2 * np.pi / LONGEST_SIDE  # sqrt(E/ρ) / size = unit · s
    if known.size_m is None and known.material is None:
        values["speed_per_size_per_s"] = _exponential(log, half, 1, unit)
        doubts.append(
            "E/ρ and the size: frequencies hold only sqrt(E/ρ) / size; give --size to find E/ρ, or --material to find "
            "the size"
        )
    elif known.size_m is None:
        values["size_m"] = _exponential(log, half, -1, known.speed_m_s / unit)
    elif known.material is None:
        values["young_per_density_m2_s2"] = _exponential(log, half, 2, (unit * known.size_m) ** 2)
        if half > _MAX_LOG:
            doubts.append(f"E/ρ: its interval spans a factor of {np.exp(4 * half):.1f}")
    if estimate.free[1]:
        poisson, half_poisson = estimate.values[1], estimate.half_width(1, PERCENT / 100)
        values["poisson"] = _interval(poisson, poisson - half_poisson, poisson + half_poisson)
        if half_poisson > _MAX_POISSON or estimate.at_bound[1]:
            why = "ends at the edge of what was tried" if estimate.at_bound[1] else f"± {half_poisson:.2f}"
            doubts.append(f"Poisson's ratio: {poisson:.2f}, {why}; these modes hardly depend on it")
    wall = 1.0
    if len(estimate.values) > 2:
        wall, half_wall = estimate.values[2], estimate.half_width(2, PERCENT / 100)
        values["wall"] = _interval(wall, wall - half_wall, wall + half_wall)
        if half_wall > _MAX_POISSON or estimate.at_bound[2]:
            why = "ends at the edge of what was tried" if estimate.at_bound[2] else f"± {half_wall:.2f}"
            doubts.append(f"the wall: {wall:.2f}, {why}; these modes hardly depend on it")
    if known.mass_kg is not None:
        if known.size_m is None:
            doubts.append("E and the density: a mass tells them apart only with --size")
        else:
            volume = (
                np.interp(wall, list(volumes), list(volumes.values())) * (known.size_m / LONGEST_SIDE) ** 3
            )
            density = known.mass_kg / volume
            values["density_kg_m3"] = _interval(density, density, density)
            values["young_pa"] = {
                name: density * one for name, one in values["young_per_density_m2_s2"].items()
            }
    return values, doubts


def _damping(found: Answer) -> dict:
    halves = found.damping.half_widths(PERCENT / 100)
    values = {"alpha_per_s": found.damping.alpha_per_s, "beta_s": found.damping.beta_s}
    return {
        name: _interval(value, max(value - half, 0.0), value + half)
        for (name, value), half in zip(values.items(), halves, strict=True)
    }


def _peaks(found: Answer, peaks, lines: Lines) -> list[dict]:
    """Return all peaks, each with its mode, counted from 1, and that mode's predicted frequency."""
    predicted = np.exp(found.estimate.values[0] + lines.log_omega)
    modes = dict(zip(found.estimate.match.peaks.tolist(), found.estimate.match.modes.tolist(), strict=True))
    rows = []
    for i in range(len(peaks)):
        mode = modes.get(i)
        rows.append(
            {
                "frequency_hz": float(peaks.frequency_hz[i]),
                "frequency_error_hz": float(peaks.frequency_error_hz[i]),
                "decay_per_s": _finite(peaks.decay_per_s[i]),
                "decay_error_per_s": _finite(peaks.decay_error_per_s[i]),
                "amplitude": float(peaks.amplitude[i]),
                "mode": None if mode is None or not found.fits else mode + 1,
                "predicted_hz": None if mode is None or not found.fits else float(predicted[mode]),
            }
        )
    return rows


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _materials(values: dict, known: Known) -> list[dict]:
    """Return the named materials, the nearest first by E/ρ and ν; each with the size it implies if that is unknown."""
    if known.material is not None:
        return []
    rows = []
    for name, one in MATERIALS.items():
        ratio = one["young_pa"] / one["density_kg_m3"]
        row = {"name": name, "poisson": one["poisson"], "young_per_density_m2_s2": ratio}
        apart = [(one["poisson"] - values["poisson"]["value"], values["poisson"], _SCATTER_POISSON, 1.0)]
        if "young_per_density_m2_s2" in values:
            heard = values["young_per_density_m2_s2"]
            logs = {key: np.log(value) for key, value in heard.items()}
            apart.append((np.log(ratio) - logs["value"], logs, _SCATTER_LOG, 1.0))
        else:
            row["size_m"] = float(np.sqrt(ratio) / values["speed_per_size_per_s"]["value"])
        squares = [
            (by / np.hypot(0.5 * (interval["high"] - interval["low"]) / 1.96, scatter)) ** 2
            for by, interval, scatter, _ in apart
        ]
        row["distance"] = float(np.sqrt(np.mean(squares)))
        row["agrees"] = row["distance"] < 2.0
        rows.append(row)
    return sorted(rows, key=lambda row: row["distance"])


#: Labels of values, and how they are written.
_LABELS = {
    "young_per_density_m2_s2": ("E/ρ (m²/s²)", "{:.4g}"),
    "speed_per_size_per_s": ("sqrt(E/ρ) / size (1/s)", "{:.5g}"),
    "size_m": ("size (m)", "{:.4g}"),
    "poisson": ("Poisson's ratio", "{:.3f}"),
    "wall": ("wall (--hollow)", "{:.3f}"),
    "density_kg_m3": ("density (kg/m³)", "{:.5g}"),
    "young_pa": ("E (Pa)", "{:.4g}"),
    "alpha_per_s": ("alpha (1/s)", "{:.3g}"),
    "beta_s": ("beta (s)", "{:.3g}"),
}


def print_facts(facts: dict, stream) -> None:
    """Print the answer."""
    size = "" if facts["size_m"] is None else f", longest side {facts['size_m']:g} m"
    of = f", {facts['known_material']}" if facts["known_material"] else ""
    print(f"{facts['sound']} on {facts['mesh']}: {facts['solidity']}{of}{size}", file=stream)
    print(f"{facts['peaks_heard']} peaks heard; {facts['sentence']}", file=stream)
    if facts["found"]:
        print(f"{'':<24}{'found':>12}   {facts['interval_percent']} % interval", file=stream)
    for name, one in facts["found"].items():
        label, form = _LABELS[name]
        low, high = form.format(one["low"]), form.format(one["high"])
        print(f"{label:<24}{form.format(one['value']):>12}   {low} to {high}", file=stream)
    for sentence in facts["not_determined"]:
        print(f"not determined: {sentence}", file=stream)
    for other in facts["others"]:
        shown = ", ".join(
            f"{_LABELS[name][0]} {_LABELS[name][1].format(one['value'])}" for name, one in other.items()
        )
        print(f"as good: {shown}", file=stream)
    agreeing = [row for row in facts["materials"] if row["agrees"]]
    for row in agreeing[:4]:
        implied = f", if the size is {row['size_m']:.3g} m" if "size_m" in row else ""
        print(
            f"agrees with {row['name']}: E/ρ {row['young_per_density_m2_s2']:.4g} m²/s², ν {row['poisson']:g}{implied}",
            file=stream,
        )
    if facts["materials"] and not agreeing:
        print(f"no named material agrees; the nearest is {facts['materials'][0]['name']}", file=stream)
    for warning in facts["warnings"]:
        print(f"warning: {warning.rstrip('.')}", file=stream)
