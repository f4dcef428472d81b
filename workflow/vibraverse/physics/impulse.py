"""Impact sounds: the sum of the responses of all modes to a strike.

The response of a mode with undamped angular frequency ``ω``, damping ``d`` and weight ``w`` to an impulse at ``t = 0``
is

    q(t) = w e^{-d t} sin(ω_d t) / ω_d        ω_d = sqrt(ω² - d²)        d < ω   (underdamped)
    q(t) = w e^{-d t} sinh(γ t) / γ           γ = sqrt(d² - ω²)          d ≥ ω   (overdamped)

With all weights 1 the sum is the location-invariant impact sound; a strike at a surface point ``x`` along ``n`` has the
weights ``u_i(x)·n``. Modes with ``ω`` above half the sample rate would alias and are left out.

A contact that lasts is a half sine of force with the same impulse (:mod:`vibraverse.physics.half_sine`). The sound
begins as the contact does. Several strikes add up: their sound is the sum of the sounds of each.

With mass-normalised modes ``q`` is in sqrt(kg)·m. It is the response to 1 sqrt(kg)·m/s on every mode or, with the
weights of a strike, to an impulse of 1 N·s at the point. Velocity and acceleration are its derivatives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vibraverse.physics.half_sine import contact_motion, impulse_motion

#: What is heard of the motion: how often the displacement is differentiated by time.
OBSERVABLES = {"displacement": 0, "velocity": 1, "acceleration": 2}
#: Shortest sound in seconds after the contact, however strong the damping.
MIN_S = 0.02
#: Length of the fade-out in seconds, which prevents a click at the end.
FADE_S = 0.01


@dataclass(frozen=True)
class Sound:
    """An impact sound, with statistics of its modes.

    ``samples`` (n,) float64 are in sqrt(kg)·m, per second or per second squared for velocity and acceleration.
    ``modes_rendered + modes_above_nyquist`` is the number of given modes; ``modes_overdamped`` counts the rendered ones
    that do not ring. ``decayed`` is true if the sound ends by its decay, false if it ends at the time limit.
    """

    samples: np.ndarray
    sample_rate_hz: int
    modes_rendered: int
    modes_above_nyquist: int
    modes_overdamped: int
    decayed: bool

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return len(self.samples) / self.sample_rate_hz


def impact_sound(
    frequencies_hz,
    damping_per_s,
    sample_rate_hz: int,
    decay_db: float = 60.0,
    max_s: float = 4.0,
    weights=None,
    contact_s: float = 0.0,
    observable: str = "displacement",
) -> Sound:
    """Return the sound of modes with undamped ``frequencies_hz`` (m,) and ``damping_per_s`` (m,).

    ``weights`` (m,) are those of a strike; None means 1 for every mode. ``contact_s`` is how long the contact lasts; 0
    is an impulse, and the sound begins just after it. ``observable`` is a name in :data:`OBSERVABLES`. After the
    contact the sound lasts until the sum of the envelopes has fallen ``decay_db`` below its maximum there, for
    :data:`MIN_S` to ``max_s`` seconds. Raises ``ValueError`` for shapes that disagree and for values that are not
    finite or not physical.
    """
    omega, damping, weights = _checked(frequencies_hz, damping_per_s, weights)
    if not 0 <= contact_s < math.inf:
        raise ValueError(f"the contact must last 0 s or longer, not {contact_s:g} s")
    audible = omega < math.pi * sample_rate_hz
    omega, damping, weight = omega[audible], damping[audible], weights[audible]
    value, motion = _after_contact(omega, damping, weight, contact_s, OBSERVABLES[observable])
    length_s, decayed = _length_s(omega, damping, value, motion, sample_rate_hz, decay_db, max_s)
    pressed = math.ceil(contact_s * sample_rate_hz)
    later_s = pressed / sample_rate_hz - contact_s
    count = max(math.ceil(length_s * sample_rate_hz), math.ceil(MIN_S * sample_rate_hz))

    rings = damping < omega
    ringing = np.sqrt((omega[rings] - damping[rings]) * (omega[rings] + damping[rings]))
    exponent = -damping[rings] + 1j * ringing
    amplitude = (motion[rings] / ringing + 1j * value[rings]) * np.exp(exponent * later_s)
    samples = _ringing(exponent, amplitude, count, 1.0 / sample_rate_hz)
    time_s = np.arange(count) / sample_rate_hz + later_s
    for mode in np.flatnonzero(~rings):
        samples += _overdamped(omega[mode], damping[mode], value[mode], motion[mode], time_s)
    if pressed:
        time_s = np.arange(pressed) / sample_rate_hz
        pushed = contact_motion(omega, damping, contact_s, time_s)[OBSERVABLES[observable]]
        samples = np.concatenate([weight @ pushed, samples])
    _fade(samples, sample_rate_hz)
    return Sound(
        samples=samples,
        sample_rate_hz=sample_rate_hz,
        modes_rendered=len(omega),
        modes_above_nyquist=len(audible) - len(omega),
        modes_overdamped=int(np.count_nonzero(~rings)),
        decayed=decayed,
    )


def _after_contact(omega, damping, weight, contact_s: float, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the free motion as the contact ends: its value ``u`` (m,) and ``u' + d u`` (m,).

    ``u`` is the derivative of the displacement of this order. Every derivative of a free motion is one, too.
    """
    value, slope = np.zeros_like(weight), weight
    if contact_s > 0:
        value, slope = weight * contact_motion(omega, damping, contact_s, np.array([contact_s]))[:2, :, 0]
    for _ in range(order):
        value, slope = slope, -2.0 * damping * slope - omega**2 * value
    return value, slope + damping * value


def _checked(frequencies_hz, damping_per_s, weights):
    """Return angular frequencies, damping and weights as float64 arrays of equal length."""
    omega = 2.0 * math.pi * np.atleast_1d(np.asarray(frequencies_hz, dtype=np.float64))
    damping = np.atleast_1d(np.asarray(damping_per_s, dtype=np.float64))
    weights = np.ones_like(omega) if weights is None else np.atleast_1d(np.asarray(weights, dtype=np.float64))
    if omega.ndim != 1 or not omega.shape == damping.shape == weights.shape:
        raise ValueError(
            "frequencies, damping and weights must be lists of one length, "
            f"not {omega.shape}, {damping.shape} and {weights.shape}"
        )
    if not all(np.isfinite(values).all() for values in (omega, damping, weights)):
        raise ValueError("frequencies, damping and weights must be finite")
    if (omega <= 0).any() or (damping < 0).any():
        raise ValueError("frequencies must be positive and damping must not be negative")
    return omega, damping, weights


def _overdamped(omega, damping, value, motion, time_s):
    """Return the free motion from ``u`` and ``u' + d u`` of modes that do not ring; arguments broadcast."""
    h, velocity = impulse_motion(omega, damping, time_s)
    return value * (velocity + damping * h) + motion * h


def _ringing(exponent, amplitude, count: int, step_s: float) -> np.ndarray:
    """Return ``Σ Im(c e^{s t})`` at ``t = 0, step, …`` for exponents s and amplitudes c (m,) of modes; (count,).

    A mode is the imaginary part of a power series, ``c z^n`` with ``z = e^{s step}``. Writing ``n = b·L + l`` splits it
    into ``c z^{bL} · z^l``. So the sum over modes is a product of two matrices with about sqrt(count) rows each, which
    takes some 500 times fewer sines than a loop over samples.
    """
    length = math.isqrt(count - 1) + 1
    blocks = -(-count // length)
    exponent = exponent * step_s
    coarse = np.exp(exponent * (np.arange(blocks)[:, None] * length)) * amplitude
    fine = np.exp(exponent * np.arange(length)[:, None])
    left = np.hstack([coarse.real, coarse.imag])
    right = np.hstack([fine.imag, fine.real])
    return (left @ right.T).ravel()[:count]


def _length_s(
    omega, damping, value, motion, sample_rate_hz: int, decay_db: float, max_s: float
) -> tuple[float, bool]:
    """Return the time in seconds when the envelopes have fallen by ``decay_db``, and whether it is before ``max_s``.

    ``value`` and ``motion`` are ``u`` and ``u' + d u`` at the start. The envelope of a ringing mode is its amplitude
    times ``e^{-d t}``, bounded by its critical limit after a period. An overdamped mode is its own envelope; it rises
    before it falls. So the sum is sampled at logarithmically spaced times, and the last crossing is found by bisection.
    """
    rings = damping < omega
    ringing = np.sqrt((omega[rings] - damping[rings]) * (omega[rings] + damping[rings]))
    place, speed = np.abs(value[rings]), np.abs(motion[rings])
    amplitude = np.hypot(speed / ringing, place)

    def level(time_s):
        time_s = np.asarray(time_s)[..., None]
        critical = place + speed * np.maximum(time_s, 1.0 / omega[rings])
        swing = np.exp(-damping[rings] * time_s) * np.minimum(amplitude, critical)
        creep = _overdamped(omega[~rings], damping[~rings], value[~rings], motion[~rings], time_s)
        return swing.sum(axis=-1) + np.abs(creep).sum(axis=-1)

    times_s = np.geomspace(0.1 / sample_rate_hz, max(max_s, MIN_S), 1000)
    levels = level(times_s)
    floor = levels.max() * 10.0 ** (-decay_db / 20.0)
    above = np.flatnonzero(levels > floor)
    if len(above) == 0:
        return 0.0, True
    if above[-1] == len(times_s) - 1:
        return max_s, False
    low, high = times_s[above[-1]], times_s[above[-1] + 1]
    while high - low > 0.5 / sample_rate_hz:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if level(middle) > floor else (low, middle)
    return float(high), True


def _fade(samples: np.ndarray, sample_rate_hz: int) -> None:
    """Fade out the last :data:`FADE_S` seconds in place, along half a cosine."""
    count = round(FADE_S * sample_rate_hz)
    samples[-count:] *= 0.5 + 0.5 * np.cos(np.pi * np.arange(1, count + 1) / count)


@dataclass(frozen=True)
class Contact:
    """The contact of a strike: corner vertices, barycentric weights, position and outward normal, (3,) each."""

    corners: np.ndarray
    barycentric: np.ndarray
    position: np.ndarray
    normal: np.ndarray

    def weights(self, at_corners: np.ndarray) -> np.ndarray:
        """Return ``u_i(x)·n`` (m,) of mode shapes (m, 3, 3) at the corners; axes: mode, corner, direction."""
        return np.einsum("mck,c,k->m", at_corners.astype(np.float64), self.barycentric, self.normal)


def strike_weights(mode_shapes, vertices, faces, point) -> np.ndarray:
    """Return each mode's weight (m,) for a strike along the normal at the surface point nearest to ``point``.

    The weight is ``u_i(x)·n``. ``mode_shapes`` (m, V, 3) at ``vertices`` (V, 3) are interpolated linearly in the
    nearest of ``faces`` (F, 3).
    """
    struck = contact(vertices, faces, point)
    return struck.weights(np.asarray(mode_shapes)[:, struck.corners])


def contact(vertices, faces, point) -> Contact:
    """Return the contact at the surface point nearest to ``point``.

    On an edge or at a corner the normal is the angle-weighted mean over the faces there (Bærentzen and Aanæs, IEEE
    Trans. Vis. Comput. Graph. 11, 243, 2005), so it does not depend on the triangulation of flat faces. Raises
    ``ValueError`` when no face has an area.
    """
    vertices, point = np.asarray(vertices, dtype=np.float64), np.asarray(point, dtype=np.float64)
    faces = np.asarray(faces)
    triangles = vertices[faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    solid = lengths > 0
    if not solid.any():
        raise ValueError("the surface has no face with an area to strike")
    faces, triangles, normals = faces[solid], triangles[solid], normals[solid] / lengths[solid, None]
    barycentric = _nearest_barycentric(triangles, normals, point)
    nearest = np.einsum("fc,fck->fk", barycentric, triangles)
    distance = np.linalg.norm(nearest - point, axis=1)
    best = int(np.argmin(distance))
    size = np.ptp(vertices, axis=0).max()
    meeting = np.linalg.norm(nearest - nearest[best], axis=1) <= 1e-9 * size
    angles = [_angle_at(*pair) for pair in zip(triangles[meeting], barycentric[meeting], strict=True)]
    normal = np.asarray(angles) @ normals[meeting]
    length = np.linalg.norm(normal)
    normal = normal / length if length > 1e-9 else normals[best]
    return Contact(faces[best], barycentric[best], nearest[best], normal)


def _nearest_barycentric(triangles, normals, point) -> np.ndarray:
    """Return barycentric coordinates (F, 3) of the nearest point to ``point`` in each triangle (F, 3, 3)."""
    inside = np.stack(
        [
            np.einsum("fk,fk->f", normals, np.cross(b - a, point - a))
            for a, b in ((triangles[:, (c + 1) % 3], triangles[:, (c + 2) % 3]) for c in range(3))
        ],
        axis=1,
    )
    result = inside / inside.sum(axis=1, keepdims=True)
    best = np.where((inside >= 0).all(axis=1), 0.0, np.inf)
    for start in range(3):
        end = (start + 1) % 3
        a, side = triangles[:, start], triangles[:, end] - triangles[:, start]
        along = np.clip(np.einsum("fk,fk->f", point - a, side) / np.einsum("fk,fk->f", side, side), 0.0, 1.0)
        away = np.linalg.norm(a + along[:, None] * side - point, axis=1)
        closer = away < best
        best = np.where(closer, away, best)
        result[closer] = 0.0
        result[closer, start], result[closer, end] = 1.0 - along[closer], along[closer]
    return result


def _angle_at(triangle, barycentric) -> float:
    """Return the angle of a triangle at one of its points: 2π inside, π on an edge, else that of the corner."""
    touched = np.flatnonzero(barycentric > 1e-9)
    if len(touched) > 1:
        return math.pi * (len(touched) - 1)
    a, b, c = np.roll(triangle, -touched[0], axis=0)
    return math.atan2(np.linalg.norm(np.cross(b - a, c - a)), np.dot(b - a, c - a))
