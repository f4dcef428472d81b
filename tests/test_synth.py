"""The page's synthesis in JavaScript against the workflow's in Python."""

from __future__ import annotations

import numpy as np
import pytest

from scripts import run_script
from vibraverse.physics.half_sine import contact_motion
from vibraverse.physics.impulse import OBSERVABLES, impact_sound
from vibraverse.physics.materials import MATERIALS

CONTACT_S = 2e-3
PUSH = np.pi / CONTACT_S
RANDOM = np.random.default_rng(7)
HZ = np.sort(RANDOM.uniform(150, 15_000, 40))
#: Ringing modes, one nearly critical, some overdamped, one at resonance with the contact, some above 22,050 Hz.
MODES = {
    "hz": [*HZ, 300.0, 310.0, 40.0, PUSH / 2 / np.pi, 21_000.0, 25_000.0, 80_000.0],
    "damping": [*(3 + 1e-3 * HZ), 0.97 * 2 * np.pi * 300, 2100.0, 9000.0, 0.0, 60.0, 9.0, 9.0],
}
WEIGHTS = RANDOM.normal(size=len(MODES["hz"]))


def test_contacts_are_those_of_python():
    omega = PUSH * np.array([0.01, 0.3, 1, 1, 1 + 1e-9, 1.01, 3, 60, 1, 0.2, 5])
    damping = omega * np.array([0.01, 0.5, 0, 1e-12, 1e-3, 0.1, 0.95, 1e-4, 1, 1e3, 30])
    time_s = np.linspace(0, CONTACT_S, 23)
    found = run_script(
        "return given.omega.map((one, place) => given.time.map((time) =>"
        " synth.contactMotion(one, given.damping[place], given.contact, time)));",
        {"omega": [*omega], "damping": [*damping], "time": [*time_s], "contact": CONTACT_S},
        "synth.js",
    )
    expected = contact_motion(omega, damping, CONTACT_S, time_s)
    error = np.abs(np.moveaxis(found, 2, 0) - expected).max(axis=2) / np.abs(expected).max(axis=2)
    assert error.max() < 1e-11


@pytest.mark.parametrize("observable", OBSERVABLES)
@pytest.mark.parametrize("contact_s", [0.0, CONTACT_S])
@pytest.mark.parametrize("weights", [None, WEIGHTS])
def test_sounds_are_those_of_python(observable, contact_s, weights):
    heard = {"contact_s": contact_s, "observable": observable}
    expected = impact_sound(MODES["hz"], MODES["damping"], 44_100, weights=weights, **heard)
    given = {
        "modes": {"omega": [2 * np.pi * hz for hz in MODES["hz"]], "damping": MODES["damping"]},
        "options": {"contact": contact_s, "observable": observable},
    }
    if weights is not None:
        given["modes"]["weights"] = [*weights]
    body = "return [300, 100].map((floorDb) => synth.render(given.modes, {...given.options, floorDb}));"
    for found, tolerance in zip(run_script(body, given, "synth.js"), (1e-8, 5e-4), strict=True):
        assert found["rendered"] == expected.modes_rendered
        assert found["aboveNyquist"] == expected.modes_above_nyquist == 2
        assert found["overdamped"] == expected.modes_overdamped == 2
        assert len(found["samples"]) == len(expected.samples)
        error = np.abs(found["samples"] - expected.samples).max()
        assert error < tolerance * np.abs(expected.samples).max()


def test_materials_and_sizes_scale_exactly():
    steel = MATERIALS["steel"]
    material = {
        "young": steel["young_pa"],
        "density": steel["density_kg_m3"],
        "alpha": steel["alpha_per_s"],
        "beta": steel["beta_s"],
    }
    unit = [0.7, 1.9, 2.8, 11.0]
    body = """
      const {unit, material} = given;
      return [synth.inMaterial(unit, material, 0.1),
        synth.inMaterial(unit, {...material, young: 4 * material.young}, 0.1),
        synth.inMaterial(unit, {...material, density: 4 * material.density}, 0.1),
        synth.inMaterial(unit, material, 0.2)];
    """
    plain, stiff, heavy, large = run_script(body, {"unit": unit, "material": material}, "synth.js")
    omega = np.array(unit) * np.sqrt(steel["young_pa"] / steel["density_kg_m3"]) / 0.1
    np.testing.assert_allclose(plain["omega"], omega, rtol=1e-14)
    np.testing.assert_allclose(plain["damping"], 0.5 * (5 + 3e-8 * omega**2), rtol=1e-14)
    np.testing.assert_allclose(stiff["omega"], 2 * omega, rtol=1e-12)
    np.testing.assert_allclose(heavy["omega"], omega / 2, rtol=1e-12)
    np.testing.assert_allclose(large["omega"], omega / 2, rtol=1e-12)


def test_a_silent_body_is_silent():
    found = run_script("return synth.render({omega: [3e5], damping: [1]});", None, "synth.js")
    assert (found["rendered"], found["aboveNyquist"]) == (0, 1)
    assert not np.any(found["samples"])
    assert len(found["samples"]) == 882
