"""A spectrogram as a small picture: time across, frequency up on the mel scale, level as colour.

    m(f) = 2595 log10(1 + f / 700)

The mel scale spreads the low partials, where a struck body has its pitch, as the ear does.
"""

from __future__ import annotations

import io

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image
from scipy.signal import ShortTimeFFT
from scipy.signal.windows import hann

#: Level at which the colours end, in decibels below the loudest point.
FLOOR_DB = -80.0
_WINDOW_S = 0.046
_TICKS_HZ = (0, 200, 500, 1000, 2000, 4000, 8000, 16_000, 32_000, 64_000)
_INK = "#4a4e57"


def mel(frequency_hz):
    """Return the mel value of a frequency in Hz."""
    return 2595.0 * np.log10(1.0 + np.asarray(frequency_hz, dtype=np.float64) / 700.0)


def mel_levels(samples, sample_rate_hz: int, rows: int = 128, columns: int = 256) -> np.ndarray:
    """Return levels in dB below the loudest point, (rows, about columns), from 0 Hz up to half the rate.

    Rows are evenly spaced in mel and columns in time. A row takes the largest power that falls into it, so no
    partial slips between rows. The Hann window is 46 ms long, shorter for sounds under 0.2 s. Silence is
    :data:`FLOOR_DB` everywhere.
    """
    samples = np.asarray(samples, dtype=np.float64)
    window = max(16, min(round(_WINDOW_S * sample_rate_hz), len(samples) // 4))
    samples = np.pad(samples, (0, max(0, window - len(samples))))
    transform = ShortTimeFFT(
        hann(window, sym=False),
        hop=max(1, len(samples) // columns),
        fs=sample_rate_hz,
        mfft=max(window, 4096),
    )
    power = transform.spectrogram(samples, p0=0, p1=max(1, len(samples) // transform.hop))
    mels = mel(transform.f)
    first = np.searchsorted(mels, np.linspace(0.0, mels[-1], rows, endpoint=False))
    image = np.maximum.reduceat(power, first, axis=0)
    peak = image.max()
    if peak == 0:
        return np.full(image.shape, FLOOR_DB)
    return np.maximum(10.0 * np.log10(np.maximum(image / peak, 1e-30)), FLOOR_DB)


def spectrogram_png(
    samples,
    sample_rate_hz: int,
    *,
    width_px: int = 420,
    height_px: int = 210,
    span_s: float | None = None,
    colormap: str = "magma",
) -> bytes:
    """Return a PNG file: the spectrogram of ``samples`` (n,) between labelled axes, on a transparent ground.

    ``span_s`` is the length of the time axis where several sounds shall compare; by default the sound's own.
    """
    samples = np.asarray(samples)
    if samples.ndim != 1 or not len(samples):
        raise ValueError(f"a spectrogram needs a list of samples, not an array of shape {samples.shape}")
    levels = mel_levels(samples, sample_rate_hz)
    duration_s, top = len(samples) / sample_rate_hz, float(mel(sample_rate_hz / 2))
    dpi = 100
    figure = Figure(figsize=(width_px / dpi, height_px / dpi), dpi=dpi)
    canvas = FigureCanvasAgg(figure)
    figure.patch.set_alpha(0.0)
    left, bottom, right, upper = 50 / width_px, 34 / height_px, 1 - 12 / width_px, 1 - 8 / height_px
    axes = figure.add_axes((left, bottom, right - left, upper - bottom))
    axes.imshow(
        levels,
        origin="lower",
        extent=(0.0, duration_s, 0.0, top),
        aspect="auto",
        cmap=colormap,
        vmin=FLOOR_DB,
        vmax=0.0,
        interpolation="nearest",
    )
    axes.set_facecolor(axes.images[0].cmap(0.0))
    axes.set_xlim(0.0, span_s or duration_s)
    axes.set_ylim(0.0, top)
    ticks = [frequency for frequency in _TICKS_HZ if frequency <= sample_rate_hz / 2]
    axes.set_yticks(mel(ticks), [f"{f // 1000}k" if f >= 1000 else str(f) for f in ticks])
    axes.tick_params(labelsize=7, colors=_INK, length=2.5)
    axes.set_xlabel("time (s)", fontsize=7.5, color=_INK, labelpad=2)
    axes.set_ylabel("frequency (Hz)", fontsize=7.5, color=_INK, labelpad=2)
    for spine in axes.spines.values():
        spine.set_color(_INK)
        spine.set_linewidth(0.6)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba()))
    file = io.BytesIO()
    # A palette halves the file; FASTOCTREE is the method that keeps transparency.
    picture.quantize(96, method=Image.Quantize.FASTOCTREE).save(file, format="PNG", optimize=True)
    return file.getvalue()
