"""Folders, globs and single files of meshes: the files found, and the ids of their objects."""

from __future__ import annotations

import os

import pytest

from mesh_bytes import make
from vibraverse.config import ConfigError, parse
from vibraverse.contract.names import slug
from vibraverse.sources.catalogue import catalogue
from vibraverse.sources.search import NoMeshes, find


@pytest.mark.parametrize(
    ("text", "id_"),
    [
        ("Cup 01", "cup-01"),
        ("__Töpfchen__", "__topfchen__"),
        ("Straße.v2", "strasse-v2"),
        ("model_normalized", "model_normalized"),
        ("a--b", "a-b"),
    ],
)
def test_slug(text, id_):
    assert slug(text) == id_


@pytest.mark.parametrize("text", ["茶壶", "чаша", "茶壶1", "...", "x" * 300, "🍵"])
def test_slug_falls_back_to_a_hash(text):
    id_ = slug(text)
    assert id_ == slug(text)
    assert id_
    assert len(id_) <= 80
    assert all(c.isascii() and (c.isalnum() or c in "-_") for c in id_)
    assert id_ != slug(text + "é茶")


def test_folder_ids_come_from_the_path_alone(tmp_path):
    make(tmp_path, "Cup.obj", "more/cup.obj", "more/deep/Vase.STL", ".hidden.obj", ".git/x.obj", "note.txt")
    before = find(str(tmp_path))
    assert {id_: path.relative_to(tmp_path).as_posix() for id_, path in before.items()} == {
        "cup": "Cup.obj",
        "more-cup": "more/cup.obj",
        "more-deep-vase": "more/deep/Vase.STL",
    }
    make(tmp_path, "aaa/cup.obj", "zebra.glb")
    after = find(str(tmp_path))
    assert before.items() <= after.items()
    assert set(after) - set(before) == {"aaa-cup", "zebra"}


def test_two_files_of_one_id_both_get_a_hash(tmp_path):
    make(tmp_path, "cup.obj", "cup.stl", "vase.obj")
    ids = find(str(tmp_path))
    assert len(ids) == 3
    assert "cup" not in ids
    assert "vase" in ids
    # the hash is that of the path below the folder: it does not depend on where the folder lies
    make(tmp_path / "elsewhere", "cup.obj", "cup.stl", "vase.obj")
    assert set(find(str(tmp_path / "elsewhere"))) == set(ids)


def test_links_that_go_round_in_circles(tmp_path):
    make(tmp_path, "in/a.obj", "outside/b.obj")
    (tmp_path / "in" / "self").symlink_to(tmp_path / "in")
    (tmp_path / "in" / "up").symlink_to(tmp_path)
    (tmp_path / "in" / "gone.obj").symlink_to(tmp_path / "nowhere")
    assert set(find(str(tmp_path / "in"))) == {"a", "up-outside-b"}
    assert set(find(str(tmp_path / "in" / "**" / "*.obj"))) == {"a"}


def test_a_link_to_a_hidden_folder_shows_it(tmp_path):
    make(tmp_path, ".v/3/a.obj", "shown/b.obj")
    (tmp_path / "current").symlink_to(".v/3")
    (tmp_path / "again").symlink_to("shown")
    assert set(find(str(tmp_path))) == {"current-a", "shown-b"}
    (tmp_path / ".v/3/up").symlink_to(tmp_path)
    assert set(find(str(tmp_path))) == {"current-a", "shown-b"}
    # What lies above the folder named is not part of the tree.
    assert set(find(str(tmp_path / ".v"))) == {"3-a", "3-up-again-b"}


def test_glob_and_file(tmp_path):
    make(tmp_path, "a/x.obj", "a/y.ply", "b/x.obj", "cup[1].obj")
    assert set(find(f"{tmp_path}/*/x.*")) == {"a-x", "b-x"}
    assert set(find(f"{tmp_path}/**/*.ply")) == {"a-y"}
    assert set(find(f"{tmp_path}/cup[1].obj")) == {"cup-1"}


def test_nothing_to_read_is_one_sentence(tmp_path):
    make(tmp_path, "docs/readme.txt", "model.step")
    for path, said in (
        (tmp_path / "gone", "does not exist; name an existing one"),
        (tmp_path / "docs", "holds no mesh files"),
        (tmp_path / "*.obj", "matches no mesh file"),
        (tmp_path / "**.obj", r"is not a valid glob: write '\*\*', which means any folders"),
        (tmp_path / "model.step", "is neither a mesh nor a manifest"),
    ):
        with pytest.raises(NoMeshes, match=said):
            find(str(path))
        with pytest.raises(ConfigError, match=r"sources\.files\[0\]\.path: .*" + said):
            catalogue(parse({"sources": {"files": [{"path": str(path)}]}}))


def test_what_is_no_file_is_left_out_of_a_folder(tmp_path):
    """Pipes, folders named like meshes, and circular or broken links neither stop nor hang a run."""
    make(tmp_path, "-dash.obj", "Töpfe & Krüge.obj", "folder.obj/in.obj", "a*?[b].obj")
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "self.obj").symlink_to("self.obj")
    assert set(find(str(tmp_path))) == {"dash", "topfe-kruge", "folder-obj-in", "a-b"}
    assert find(str(tmp_path / "-dash.obj")) == {"dash": tmp_path / "-dash.obj"}
    with pytest.raises(NoMeshes, match="neither a file nor a folder"):
        find(str(tmp_path / "pipe.stl"))


@pytest.mark.parametrize(
    ("name", "said"), [("cup{a}.obj", "braces"), ("a\nb.obj", "printed"), (b"\xff.obj", "cannot be printed")]
)
def test_names_that_no_rule_can_carry(tmp_path, name, said):
    (tmp_path / os.fsdecode(name)).write_text("v 0 0 0")
    with pytest.raises(NoMeshes, match=said) as error:
        find(str(tmp_path))
    assert "rename it" in str(error.value)
    assert str(error.value).isprintable()


def test_a_name_that_looks_like_the_hash_of_another(tmp_path):
    make(tmp_path, "cup.obj", "cup.stl")
    hashed = next(iter(find(str(tmp_path))))
    make(tmp_path, f"{hashed}.obj")
    with pytest.raises(NoMeshes, match=f"two files have the id '{hashed}'"):
        find(str(tmp_path))


def test_what_a_run_made_is_no_source_of_the_next(tmp_path, monkeypatch):
    make(tmp_path, "cup.obj", "more/bell.obj", "results/objects/cup/surface.ply", "results-of-old/a.ply")
    results = str(tmp_path / "results")
    assert set(find(str(tmp_path), results)) == {"cup", "more-bell", "results-of-old-a"}
    assert set(find(f"{tmp_path}/**/*.ply", results)) == {"results-of-old-a"}
    # Asked for by name, it is what is asked for.
    assert set(find(results, results)) == {"objects-cup-surface"}
    assert set(find(f"{results}/objects/*/surface.ply", results)) == {"cup-surface"}
    monkeypatch.chdir(tmp_path)
    files = catalogue(
        parse({"sources": {"generated": {"count": 0}, "bundled": [], "files": [{"path": "."}]}})
    )
    assert set(files) == {"cup", "more-bell", "results-of-old-a"}
