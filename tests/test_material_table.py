"""Materials: the named table, a user's own, and parameters of no real solid."""

from __future__ import annotations

import pytest

from vibraverse.config import ConfigError, load, parse
from vibraverse.physics.materials import MATERIALS

OWN = {"density_kg_m3": 1000, "young_pa": 1e9, "poisson": 0.3, "alpha_per_s": 1, "beta_s": 1e-7}


def test_materials_of_the_table_and_your_own():
    config = parse({"materials": {"tin": None, "jelly": OWN}})
    assert config.materials["tin"].density_kg_m3 == 7265
    assert config.materials["jelly"].young_pa == 1e9


def test_the_form_that_is_advised_for_materials_is_taken(tmp_path):
    with pytest.raises(ConfigError) as caught:
        parse({"materials": ["steel", "tin"]})
    advised = str(caught.value).partition("; write ")[2].partition(", or ")[0]
    (tmp_path / "config.yaml").write_text(advised)
    assert list(load(tmp_path / "config.yaml").materials) == ["steel", "tin"]


def test_no_real_solid_is_refused():
    pairs = {
        "aerogel": (2, 1e3), "melamine-foam": (6, 1e5), "balsa": (60, 1.5e9), "jelly": (1050, 2e3),
        "rubber": (930, 1e6), "tungsten-silicone": (11_000, 2.5e6), "lead": (11_340, 1.4e10),
        "osmium": (22_590, 5.5e11), "diamond": (3510, 1.22e12), "beryllium": (1848, 2.87e11),
        "carbon-fibre": (2200, 9.3e11), "nanotube": (1400, 1e12), "sampled": (500, 5e11),
    }  # fmt: skip
    values = {name: {**OWN, "density_kg_m3": one[0], "young_pa": one[1]} for name, one in pairs.items()}
    assert len(parse({"materials": values}).materials) == len(pairs)
    parse({"sources": {"sizes_m": {"grain": 0.001, "hall": 50}}})


def test_the_table_of_materials(vibraverse):
    status, out, _ = vibraverse("materials")
    lines = out.splitlines()
    assert status == 0
    assert len(lines) == 1 + len(MATERIALS)
    assert lines[0].split() == [
        "material",
        "density",
        "kg/m³",
        "Young",
        "Pa",
        "Poisson",
        "alpha",
        "1/s",
        "beta",
        "s",
    ]
    assert lines[1].split() == ["ceramic", "2700", "7.2e+10", "0.19", "6", "1e-07"]
