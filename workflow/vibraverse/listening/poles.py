"""Damped exponentials in a complex signal: frequencies, decay rates and amplitudes with their standard errors.

The signal is ``y[n] = Σ c_k z_k^n + noise`` with poles ``z = e^s``. ESPRIT (Roy and Kailath, IEEE Trans. Acoust. Speech
Signal Process. 37, 984, 1989) finds the poles from the invariance of the signal's subspace under a shift by a sample.
Gauss-Newton steps then minimise the squared residual over poles and amplitudes at once. The standard errors are
the Cramér-Rao bounds at the solution, with the noise taken from the residual.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

#: Most poles of one signal, as a share of its samples.
_MAX_SHARE = 0.25
#: Singular values of noise follow the law of Marchenko and Pastur. The threshold that is best against unknown noise, in
#: units of the median singular value of a square matrix (Gavish and Donoho, IEEE Trans. Inf. Theory 60, 5040, 2014).
_SINGULAR_THRESHOLD = 2.858
#: Most steps of Gauss and Newton, those while poles are still dropped, and the relative fall of the residual at which
#: they end.
_MAX_STEPS, _FEW_STEPS, _SMALL_FALL = 12, 3, 1e-6
#: A pole whose amplitude is below this many standard errors is noise.
_MIN_SIGNIFICANCE = 5.0


@dataclass(frozen=True)
class Poles:
    """Exponents ``s`` (k,) per sample, amplitudes ``c`` (k,) and their standard errors (k,).

    ``error`` is that of the real and of the imaginary part of ``s`` each; ``noise`` is the residual's root mean square.
    """

    exponents: np.ndarray
    amplitudes: np.ndarray
    error: np.ndarray
    amplitude_error: np.ndarray
    noise: float


def find(signal: np.ndarray) -> Poles:
    """Return the significant poles of a complex signal (n,) in white noise; none if it has fewer than eight samples."""
    count = len(signal)
    if count < 8 or not np.abs(signal).max() > 0:
        return _none(signal)
    exponents = _esprit(signal, int(_MAX_SHARE * count))
    found = _refine(signal, exponents, _FEW_STEPS)
    while len(found.exponents):
        good = _significant(found)
        if good.all():
            break
        # The weakest goes first, because two poles that share a peak make each other uncertain.
        doubts = found.amplitude_error / np.abs(found.amplitudes)
        keep = np.delete(np.arange(len(good)), np.argmax(np.where(good, 0.0, doubts)))
        found = _refine(signal, found.exponents[keep], _FEW_STEPS)
    return _refine(signal, found.exponents, _MAX_STEPS)


def _none(signal: np.ndarray) -> Poles:
    empty = np.zeros(0)
    noise = float(np.sqrt(np.mean(np.abs(signal) ** 2))) if len(signal) else 0.0
    return Poles(empty.astype(complex), empty.astype(complex), empty, empty, noise)


def _significant(poles: Poles) -> np.ndarray:
    """Return which poles (k,) stand out of the noise and decay, as far as their errors tell."""
    strong = np.abs(poles.amplitudes) > _MIN_SIGNIFICANCE * poles.amplitude_error
    return strong & (poles.exponents.real < 2 * poles.error)


def _esprit(signal: np.ndarray, most: int) -> np.ndarray:
    """Return the exponents of the poles whose singular values exceed those of noise, at most ``most``."""
    rows = len(signal) // 2
    left, sizes, _ = scipy.linalg.svd(
        scipy.linalg.hankel(signal[:rows], signal[rows - 1 :]), full_matrices=False, check_finite=False
    )
    order = int(np.count_nonzero(sizes > _SINGULAR_THRESHOLD * np.median(sizes)))
    order = max(1, min(order, most))
    space = left[:, :order]
    shift = scipy.linalg.lstsq(space[:-1], space[1:], check_finite=False)[0]
    poles = scipy.linalg.eigvals(shift, check_finite=False)
    poles = poles[np.abs(poles) > 1e-3]
    # An exponential that grows is noise; refinement may still turn it into one that decays slowly.
    exponents = np.log(poles)
    return np.minimum(exponents.real, 0.0) + 1j * exponents.imag


def _refine(signal: np.ndarray, exponents: np.ndarray, steps: int) -> Poles:
    """Return the least-squares solution next to some exponents (k,), with its standard errors.

    The model is analytic in its complex parameters, so a complex least-squares problem gives each step.
    """
    if not len(exponents):
        return _none(signal)
    time = np.arange(len(signal))[:, None]

    def solved(exponents):
        powers = np.exp(exponents * time)
        amplitudes = np.linalg.lstsq(powers, signal, rcond=1e-10)[0]
        residual = signal - powers @ amplitudes
        return powers, amplitudes, residual, np.vdot(residual, residual).real

    powers, amplitudes, residual, squares = solved(exponents)
    for _ in range(steps):
        jacobian = np.hstack([powers, time * powers * amplitudes])
        step = np.linalg.lstsq(jacobian, residual, rcond=1e-10)[0][len(exponents) :]
        scale = 1.0
        for _ in range(6):
            tried = exponents + scale * step
            tried = np.minimum(tried.real, 1.0 / len(signal)) + 1j * tried.imag
            attempt = solved(tried)
            if attempt[3] < squares:
                break
            scale *= 0.5
        else:
            break
        fall = 1.0 - attempt[3] / squares
        exponents, (powers, amplitudes, residual, squares) = tried, attempt
        if fall < _SMALL_FALL:
            break
    jacobian = np.hstack([powers, time * powers * amplitudes])
    freedom = max(len(signal) - jacobian.shape[1], 1)
    variance = squares / freedom
    covariance = variance * np.abs(np.diag(np.linalg.pinv(jacobian.conj().T @ jacobian, hermitian=True)))
    errors = np.sqrt(covariance / 2.0)
    return Poles(exponents, amplitudes, errors[len(exponents) :], errors[: len(exponents)], np.sqrt(variance))
