"""The configuration: defaults, every kind of mistake in one sentence, and generated files that have not drifted."""

from __future__ import annotations

import jsonschema
import pytest
import yaml

from vibraverse.config import Config, ConfigError, load, parse, schema_text, validate
from vibraverse.config.dataset import ShardOptions
from vibraverse.config.reference import markdown
from vibraverse.physics.materials import MATERIALS

OWN = {"density_kg_m3": 1000, "young_pa": 1e9, "poisson": 0.3, "alpha_per_s": 1, "beta_s": 1e-7}


def test_an_empty_configuration_is_the_default_run():
    config = parse({})
    assert list(config.materials) == ["ceramic", "glass", "wood", "steel"]
    assert config.materials["wood"].young_pa == MATERIALS["wood"]["young_pa"]
    assert config.sources.generated.count == 8
    assert config.sources.bundled == ["nut", "airplane", "ant"]
    assert config.solidities == ["solid", "hollow"]
    assert parse(None) == config


def test_braces_are_the_shortest_file(tmp_path):
    (tmp_path / "config.yaml").write_text("{}\n")
    assert load(tmp_path / "config.yaml") == parse({})


def test_every_product_has_a_name_of_its_own():
    materials = {"steel": None, "steel-p1": OWN}
    for points in ([], [[0, 0, 1]]):
        names = parse({"materials": materials, "audio": {"points": points}}).audio.names(materials)
        assert len(set(names)) == len(names) == 2 + 2 * len(points)
    images = parse({"images": {"looks": ["clay", "steel", "clay"], "views": 1}}).images
    assert images.names() == ["clay-00", "steel-00"]


def test_numbers_that_yaml_takes_for_text(tmp_path):
    # YAML reads 2e11 (no dot, no sign) as text; a modulus written so is a number all the same.
    path = tmp_path / "config.yaml"
    path.write_text(yaml.safe_dump({"materials": {"x": OWN}}).replace("1000000000.0", "2e11"))
    assert yaml.safe_load(path.read_text())["materials"]["x"]["young_pa"] == "2e11"
    assert load(path).materials["x"].young_pa == 2e11


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        (
            {"sourcess": {}},
            "unknown key 'sourcess'; did you mean 'sources'? (known: results, slice, sources, ",
        ),
        (
            {"dataset": {"shard": 3}},
            "unknown key 'dataset.shard'; did you mean 'shards'? (known: shards, splits, ",
        ),
        (
            {"learn": {"features": {"ritz_degrees": [6, 4, 4]}}},
            "learn.features.ritz_degrees: [6, 4, 4] do not ascend; write [4, 6]",
        ),
        (
            {"learn": {"gpus": 3}},
            "learn: frequencies.training.batch_size is 16, which 3 GPUs cannot share equally; make it a multiple",
        ),
        ({"sources": {"files": [{"pat": "x"}]}}, "unknown key 'sources.files[0].pat'; did you mean 'path'?"),
        ({"sources": {"files": [{"path": "a"}, {}]}}, "sources.files[1].path is missing"),
        (
            {"materials": {"own": {**OWN, "alpha": 1}}},
            "unknown key 'materials.own.alpha'; did you mean 'alpha_per_s'?",
        ),
        (
            {"materials": {"stell": None}},
            "materials: unknown material 'stell'; did you mean 'steel'? (known: ceramic,",
        ),
        (
            {"materials": {"own": {**OWN, "density_kg_m3": -1}}},
            "materials.own.density_kg_m3 must be greater than 0, not -1",
        ),
        (
            {"materials": {"own": {**OWN, "poisson": 0.5}}},
            "materials.own.poisson must be less than 0.5, not 0.5",
        ),
        (
            {"materials": {"own": {**OWN, "poisson": -1}}},
            "materials.own.poisson must be greater than -1, not -1",
        ),
        (
            {"materials": {"own": {**OWN, "young_pa": 200}}},
            "materials.own.young_pa: 200 Pa is softer than any solid; write 2.0e+11 for 200 GPa",
        ),
        (
            {"materials": {"own": {**OWN, "young_pa": 2e14}}},
            "materials.own.young_pa: 2e+14 Pa is stiffer than any solid; write Pa, at most 1.5e+12",
        ),
        (
            {"materials": {"own": {**OWN, "density_kg_m3": 0.75}}},
            "materials.own.density_kg_m3: 0.75 kg/m³ is lighter than air; write 750 for 0.75 g/cm³",
        ),
        (
            {"materials": {"own": {**OWN, "density_kg_m3": 7.85e6}}},
            "materials.own.density_kg_m3: 7.85e+06 kg/m³ is heavier than any solid; write kg/m³, at most 25000",
        ),
        (
            {"materials": {"own": {**OWN, "density_kg_m3": 7.85, "young_pa": 2e11}}},
            "materials.own: density_kg_m3 7.85 and young_pa 2e+11 are not of one solid, sound would travel at 160 km/s "
            "and nowhere exceeds 35; write 7850 for 7.85 g/cm³",
        ),
        (
            {"materials": {"own": {**OWN, "young_pa": 1.4e12}}},
            "materials.own: density_kg_m3 1000 and young_pa 1.4e+12 are not of one solid, sound would travel at "
            "37 km/s and nowhere exceeds 35; check both units",
        ),
        (
            {"materials": {"own": {**OWN, "density_kg_m3": 7850, "young_pa": 200_000}}},
            "materials.own: density_kg_m3 7850 and young_pa 200000 are not of one solid, sound would travel at 5.0 m/s "
            "and is faster than 12 in all that is so dense; write 2.0e+11 for 200000 MPa",
        ),
        (
            {"sampled": {"young_pa": [0.5, 5e11]}},
            "sampled.young_pa[0]: 0.5 Pa is softer than any solid; write 5.0e+08 for 0.5 GPa",
        ),
        (
            {"sources": {"files": [{"path": "a", "size_m": 200}]}},
            "sources.files[0].size_m: 200 m is more than the 50 m that an object may have; write 0.2 for 200 mm",
        ),
        (
            {"sources": {"sizes_m": {"mug": 1e-4}}},
            "sources.sizes_m.mug: 0.0001 m is less than the 0.001 m that an object may have; write metres",
        ),
        (
            {"sources": {"default_size_m": 1e6}},
            "sources.default_size_m: 1e+06 m is more than the 50 m that an",
        ),
        ({"materials": {"own": 5}}, "materials.own must hold keys and values, not 5"),
        (
            {"materials": {"sampled-0001": OWN}},
            "materials: the material name 'sampled-0001' is reserved for sampled materials",
        ),
        (
            {"sampled": {"young_pa": [2e9, 1e9]}},
            "sampled.young_pa: must ascend, not fall from 2e+09 to 1e+09",
        ),
        ({"sampled": {"count": -1}}, "sampled.count must be at least 0, not -1"),
        (
            {"sampled": {"count": 1, "poisson": [0.1, 0.45]}},
            "sampled.poisson (0.1 to 0.45) must lie in basis.poisson_range (0.1 to 0.4): sampled materials are",
        ),
        (
            {"sampled": {"count": 2}, "audio": {"sampled": 3}},
            "audio.sampled must be at most sampled.count, 2, not 3",
        ),
        (
            {"materials": {"steel": None, "steel-p0": OWN}, "audio": {"points": [[0, 0, 1]]}},
            "materials: the sound of 'steel-p0' has the name of that of 'steel' struck at a point of audio.points,",
        ),
        ({"materials": {}}, "materials must hold 1 or more, not nothing"),
        (
            {"materials": {"a b": OWN}},
            "materials: the material name 'a b' may hold only letters, digits, '-' and '_'",
        ),
        (
            {"materials": ["steel", "tin"]},
            'materials must hold keys and values, not ["steel", "tin"]; write materials: {steel: , tin: }, or each',
        ),
        (
            {"materials": [{"tin": None}]},
            'materials must hold keys and values, not [{"tin": null}]; write materials: {tin: },',
        ),
        (
            {"materials": "steel"},
            'materials must hold keys and values, not "steel"; write materials: {steel: }, or each',
        ),
        (
            {"materials": None},
            "materials must hold keys and values, not nothing; write materials: {steel: }, or each",
        ),
        ({"solidities": ["hollo"]}, "solidities: unknown solidity 'hollo'; did you mean 'hollow'?"),
        ({"images": {"looks": ["cly"]}}, "images.looks: unknown look 'cly'; did you mean 'clay'?"),
        ({"solidities": "solid"}, 'solidities must be a list, not "solid"'),
        ({"dataset": {"shards": "four"}}, 'dataset.shards must be a whole number, not "four"'),
        ({"dataset": {"shards": 2.5}}, "dataset.shards must be a whole number, not 2.5"),
        ({"dataset": {"shards": 0}}, "dataset.shards must be at least 1, not 0"),
        ({"audio": {"points": [[0, 0, 0.9], [15, 0, 0]]}}, "audio.points[1][0] must be at most 1, not 15"),
        ({"dataset": {"max_refused_share": 1.5}}, "dataset.max_refused_share must be at most 1, not 1.5"),
        ({"dataset": {"splits": {"a": 0.5}}}, "dataset.splits: the shares must add up to 1, not 0.5"),
        (
            {"dataset": {"splits": {"a": -1, "b": 2}}},
            "dataset.splits: the share of 'a' must not be negative, not -1",
        ),
        (
            {"dataset": {"splits": {"a\tb": 1}}},
            "dataset.splits: the split name 'a\\tb' may hold only letters,",
        ),
        ({"basis": {"order": 3}}, "basis.order must be 1 or 2, not 3"),
        ({"basis": {"poisson_range": [0.1, 0.5]}}, "basis.poisson_range[1] must be less than 0.5, not 0.5"),
        ({"sources": {"generated": {"families": 5}}}, "sources.generated.families must be a list, not 5"),
        ({"audio": {"points": [[0, 0]]}}, "audio.points[0][2] is missing"),
        ({"audio": {"max_s": float("inf")}}, "audio.max_s must be a finite number, not Infinity"),
        ({"sources": None}, "sources must hold keys and values, not nothing"),
        ({"results": 5}, "results must be text, not 5"),
        ({1: 2}, "the key '1' must be text"),
    ],
    ids=lambda value: value[:40] if isinstance(value, str) else None,
)
def test_every_mistake_is_one_sentence(values, sentence):
    with pytest.raises(ConfigError) as caught:
        parse(values)
    said = str(caught.value)
    assert said.startswith(sentence)
    assert "\n" not in said
    assert "pydantic" not in said


@pytest.mark.parametrize(
    ("values", "sentences"),
    [
        (
            {"dataset": {"shards": 0}, "basis": {"order": 3}, "soures": {}},
            [
                "unknown key 'soures'; did",
                "basis.order must be 1 or 2,",
                "dataset.shards must be at least 1,",
            ],
        ),
        (
            {"materials": {"own": {"density_kg_m3": 1, "young": 1e9, "alpha_per_s": 1, "beta_s": 0}}},
            [
                "unknown key 'materials.own.young'; did you mean 'young_pa'?",
                "materials.own.poisson is missing",
            ],
        ),
        (
            {"sources": {"generated": {"families": [5, 6], "count": -1}}},
            [
                "sources.generated.count must",
                "sources.generated.families[0] must",
                "sources.generated.families[1] must",
            ],
        ),
        (
            {"materials": {f"own-{number}": 5 for number in range(15)}},
            [
                *(f"materials.own-{number} must hold keys and values, not 5" for number in range(10)),
                "and 5 more",
            ],
        ),
    ],
)
def test_several_mistakes_are_listed(tmp_path, vibraverse, values, sentences):
    with pytest.raises(ConfigError) as caught:
        parse(values)
    first, *lines = str(caught.value).splitlines()
    assert first.startswith("the configuration has ")
    path = tmp_path / "config.yaml"
    path.write_text(yaml.safe_dump(values, sort_keys=False))
    status, _, errors = vibraverse("config", "check", path)
    said, *again = errors.splitlines()
    assert (status, again) == (2, lines)
    assert said == f"vibraverse: {path} has {len(caught.value.mistakes)} mistakes:"
    assert len(lines) == len(sentences)
    for line, sentence in zip(lines, sentences, strict=True):
        assert line.startswith(f"  {sentence}")


def test_a_stage_s_options_are_named_with_the_stage():
    with pytest.raises(ConfigError, match=r"^unknown key 'dataset\.objets'; did you mean 'objects'"):
        validate(ShardOptions, {"objets": [], "materials": ["steel"]}, prefix="dataset")
    with pytest.raises(ConfigError, match=r"^dataset\.materials must hold 1 or more, not nothing$"):
        validate(ShardOptions, {"materials": []}, prefix="dataset")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("a: [1, 2\nb: 3", "line 2, column 2 is not valid YAML"),
        ("- just\n- a list", 'must hold keys and values, not ["just", "a list"]'),
        ("", "holds no keys; write {} for a run with every default"),
        ("# materials:\n", "config.yaml holds no keys; write {} for"),
        ("text alone", 'must hold keys and values, not "text alone"'),
        ("dataset:\n  shardz: 1\n", "config.yaml: unknown key 'dataset.shardz'"),
        (b"\xff\xfe\x00", "is not valid YAML"),
    ],
)
def test_bad_files(tmp_path, vibraverse, content, words):
    path = tmp_path / "config.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    for action in ("check", "show"):
        status, out, errors = vibraverse("config", action, path)
        assert status == 2
        assert words in errors
        assert len(errors.splitlines()) == 1
        assert out == ""


def test_a_missing_file(tmp_path, vibraverse):
    status, _, errors = vibraverse("config", "check", tmp_path / "none.yaml")
    assert status == 2
    assert errors.endswith("none.yaml does not exist; create it, or name another one\n")


def test_check_and_show(tmp_path, vibraverse):
    path = tmp_path / "config.yaml"
    path.write_text("sources:\n  generated: {count: 2}\nmaterials:\n  tin:\n", encoding="utf-8")
    assert vibraverse("config", "check", path)[:2] == (0, f"{path} is valid and names 5 objects.\n")
    status, out, _ = vibraverse("config", "show", path)
    assert status == 0
    shown = yaml.safe_load(out)
    assert shown["sources"]["generated"]["count"] == 2
    assert shown["materials"]["tin"]["beta_s"] == 3e-8
    # What is shown is itself a configuration, and means the same.
    assert parse(shown) == load(path)


def test_a_tilde_is_the_home_folder(monkeypatch):
    monkeypatch.setenv("HOME", "/home/ada")
    assert parse({"results": "~/out"}).results == "/home/ada/out"
    assert parse({"results": "out~/~"}).results == "out~/~"


def test_check_looks_for_the_files(tmp_path, vibraverse):
    path = tmp_path / "config.yaml"
    path.write_text(
        f"sources:\n  files: [{{path: {tmp_path}/nowhere}}]\nmaterials:\n  tin:\n", encoding="utf-8"
    )
    status, out, err = vibraverse("config", "check", path)
    assert (status, out) == (2, "")
    assert "sources.files[0].path: the file or folder " in err


def test_check_says_what_a_run_would(tmp_path, vibraverse, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "config.yaml"
    path.write_text("dataset: {keep_splits: old.tsv}\n")
    status, _, errors = vibraverse("config", "check")
    assert (status, errors) == (
        2,
        "vibraverse: dataset.keep_splits: the file old.tsv does not exist; name the splits.tsv of a dataset\n",
    )
    said = []
    for part in ("1/2", "2/2"):
        path.write_text(f"slice: {part}\nsources: {{generated: {{count: 0}}, bundled: [nut]}}\n")
        said.append(vibraverse("config", "check")[1].partition("names ")[2])
    assert sorted(said) in (
        ["0 objects in slice 1/2.\n", "1 object in slice 2/2.\n"],
        ["0 objects in slice 2/2.\n", "1 object in slice 1/2.\n"],
    )
    assert sorted(tmp_path.iterdir()) == [path]


def test_the_schema_accepts_what_the_sections_accept(vibraverse):
    status, out, _ = vibraverse("config", "schema")
    assert status == 0
    schema = yaml.safe_load(out)
    jsonschema.validate(Config().model_dump(mode="json"), schema)
    jsonschema.validate({"materials": {"tin": None}}, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({"datasets": {}}, schema)


def test_the_committed_schema_has_not_drifted(root):
    committed = (root / "workflow/schemas/config.schema.json").read_text(encoding="utf-8")
    assert committed == schema_text(), (
        "write it again: vibraverse config schema > workflow/schemas/config.schema.json"
    )


def test_the_documentation_has_not_drifted(root, vibraverse):
    text = (root / "docs/configuration.md").read_text(encoding="utf-8")
    assert markdown() in text, "docs/configuration.md: replace its tables by `vibraverse config reference`"
    assert vibraverse("config", "reference")[1] == markdown()


def test_every_key_is_explained():
    rows = [line.split(" | ") for line in markdown().splitlines() if line.startswith("| `")]
    assert len(rows) > 40
    assert [row[0] for row in rows if len(row[2]) < 8] == []


def test_a_configuration_without_objects_is_refused(vibraverse, tmp_path):
    path = tmp_path / "config.yaml"
    path.write_text("sources: {generated: {count: 0}, bundled: []}\n")
    status, _, errors = vibraverse("config", "check", path)
    assert status == 2
    assert "sources: no object is named" in errors
