"""Sounds that pages play from files, and quantities as people read them."""

from __future__ import annotations

import io

import numpy as np
import pytest
import soundfile
from PIL import Image

from vibraverse.report import quantities, sounds
from vibraverse.report.learning import figures


def test_spectrogram_shows_the_tone_where_it_is():
    rate = 44_100
    time = np.arange(rate) / rate
    tone = np.exp(-3 * time) * np.sin(2 * np.pi * 4000 * time)
    picture = np.asarray(Image.open(io.BytesIO(sounds.spectrogram(tone, rate))))
    height = sounds.marks(rate)["4 k"]
    brightest = picture.astype(int).mean(axis=1).argmax()
    assert 100 * (1 - brightest / len(picture)) == pytest.approx(height, abs=2)
    assert list(sounds.marks(16_000)) == ["1 k", "4 k"]


def test_flac_keeps_16_bits():
    samples = np.random.default_rng(1).uniform(-0.9, 0.9, 5000).astype(np.float32)
    data = sounds.flac(samples, 44_100)
    back, rate = soundfile.read(io.BytesIO(data))
    assert rate == 44_100
    assert np.abs(back - samples).max() <= 1 / 2**15
    assert sounds.flac(samples, 44_100) == data


@pytest.mark.parametrize(
    ("function", "value", "text"),
    [
        (quantities.length, 0.18, "18 cm"),
        (quantities.length, 0.0042, "4.2 mm"),
        (quantities.length, 1.25, "1.25 m"),
        (quantities.volume, 2.16e-4, "216 cm³"),
        (quantities.volume, 2.95e-3, "2.95 L"),
        (quantities.volume, 4e-9, "4 mm³"),
        (quantities.mass, 0.5832, "583 g"),
        (quantities.mass, 23.16, "23.2 kg"),
        (quantities.frequency, 2717.0, "2,720 Hz"),
        (quantities.frequency, 25029.0, "25 kHz"),
        (quantities.duration, 0.3927, "393 ms"),
        (quantities.duration, 1.0334, "1.03 s"),
        (quantities.file_size, 862_315, "862 kB"),
        (quantities.number, 0, "0"),
        (quantities.number, 1_234_567, "1,230,000"),
        (quantities.number, 0.999999, "1"),
    ],
)
def test_quantities(function, value, text):
    assert function(value).replace("\u202f", " ") == text


def test_axis_ticks():
    assert figures.ticks(90, 2100) == [100, 200, 500, 1000, 2000]
    low, high = figures.axis(100.0, 10_000.0)
    assert low < 100 < 10_000 < high
