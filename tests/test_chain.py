"""The jobs of an object together: how they were made, and the first refusal."""

from __future__ import annotations

from vibraverse.contract import products
from vibraverse.contract.refusal import Refusal
from vibraverse.dataset.write import making
from vibraverse.flow import chain
from vibraverse.flow.paths import Paths


def test_making_keeps_what_agrees():
    def one(seed, version="1"):
        return {
            "tets": {
                "stage_version": 1,
                "options": {"target": 6000, "seed": seed},
                "libraries": {"gmsh": version},
            }
        }

    joined = making.join([one(1), one(2), one(3, "2")])
    assert joined["tets"]["options"] == {"target": 6000, "seed": making.VARIES}
    assert joined["tets"]["libraries"] == {"gmsh": making.VARIES}
    assert making.join([making.join([one(1), one(2)]), one(3, "2")]) == joined


def test_the_first_refusal_of_the_chain_counts(tmp_path):
    paths = Paths(tmp_path)
    for product, stage in (("tets_record", "tets"), ("modes", "tets"), ("audio_record", "audio")):
        path = paths.at(getattr(paths, product), object="x", solidity="solid")
        products.write_text(path, Refusal("x", stage, "too_thin", "m", solidity="solid").to_text())
    found = chain.refusals_of(paths, "x")
    assert found.object is None
    assert found.bodies["solid"].stage == "tets"
    assert not found.is_refused(("solid", "hollow"))
    assert found.is_refused(("solid",))
    assert chain.objects_in(paths) == ["x"]
    assert chain.objects_in(Paths(tmp_path / "nowhere")) == []
