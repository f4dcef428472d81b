"""Failures of a machine, each provoked with stand-ins for its commands."""

from __future__ import annotations

import types
from collections.abc import Callable

from stand_ins import stub
from vibraverse.config import parse
from vibraverse.flow.plan import Plan
from vibraverse.machine import containers, gpus, preflight, slurm


def _slurm(bin_):
    stub(bin_, "sinfo", "echo 'cpu*|64000|(null)|2:00:00'; echo 'gpu|32000|gpu:a100:2(S:0-1)|infinite'")
    stub(bin_, "squeue", "true")


def _asks(**resources) -> Callable:
    def provoke(bin_, tmp_path, monkeypatch):
        _slurm(bin_)
        slurm.check([("tets", resources, 1)], tmp_path)

    return provoke


def _busy(bin_, tmp_path, monkeypatch):
    _slurm(bin_)
    stub(bin_, "squeue", f"echo '17|{tmp_path}'")
    slurm.check([], tmp_path)


def _silent(bin_, tmp_path, monkeypatch):
    stub(bin_, "sinfo", "echo 'unable to contact the controller' >&2; exit 1")
    slurm.check([], tmp_path)


def _without_slurm(bin_, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    slurm.check([], tmp_path)


def _accounts(kept: str, command: str | None) -> Callable:
    def provoke(bin_, tmp_path, monkeypatch):
        _slurm(bin_)
        stub(bin_, "sacct", "echo 'Slurm accounting storage is disabled' >&2; exit 1")
        stub(bin_, "scontrol", f"echo 'MinJobAge = {kept} sec'")
        settings = types.SimpleNamespace(status_command=command, init_seconds_before_status_checks=None)
        slurm.check([], tmp_path, settings)

    return provoke


def _two_gpus(count: int, visible: str | None = None) -> Callable:
    def provoke(bin_, tmp_path, monkeypatch):
        stub(bin_, "nvidia-smi", "echo '0, GPU-a, A100, 80000, 1'; echo '1, GPU-b, A100, 80000, 1'")
        if visible is None:
            monkeypatch.delenv(gpus.VISIBLE, raising=False)
        else:
            monkeypatch.setenv(gpus.VISIBLE, visible)
        monkeypatch.setenv(gpus.LOCKS, str(tmp_path))
        with gpus.Claim(count, 0.1), gpus.Claim(2, 0.1):
            pass

    return provoke


def _no_gpu(bin_, tmp_path, monkeypatch):
    monkeypatch.delenv(gpus.VISIBLE, raising=False)
    stub(bin_, "nvidia-smi", "exit 9")
    gpus.enough_of(1)


def _claimed_elsewhere(bin_, tmp_path, monkeypatch):
    stub(bin_, "nvidia-smi", "echo '0, GPU-a, A100, 80000, 1'")
    monkeypatch.delenv(gpus.VISIBLE, raising=False)
    monkeypatch.setenv(gpus.LOCKS, str(tmp_path))
    with gpus.Claim(1, 0.1):
        monkeypatch.delenv(gpus.CLAIMED)
        with gpus.Claim(1, 0.1):
            pass


def _without_apptainer(bin_, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    preflight.apptainer()


def _spaces(bin_, tmp_path, monkeypatch):
    stub(bin_, "apptainer", "true")
    monkeypatch.setenv("VIBRAVERSE_IMAGES", "/my images")
    preflight.apptainer()


def _no_image(bin_, tmp_path, monkeypatch):
    stub(bin_, "apptainer", "exit 1")
    monkeypatch.setenv("VIBRAVERSE_IMAGES", str(tmp_path))
    preflight.images([containers.image("fem")])


def _unseen(bin_, tmp_path, monkeypatch):
    stub(bin_, "apptainer", "echo /data/mug.obj")
    monkeypatch.setenv("VIBRAVERSE_IMAGES", str(tmp_path))
    preflight.seen_in_images(["/data/mug.obj"])


def _known(kind: str, name: str) -> Callable:
    def provoke(bin_, tmp_path, monkeypatch):
        plan = Plan(parse({"sources": {"bundled": ["nut"], "generated": {"count": 1}}}).model_dump())
        preflight.known(plan, ["mine.yaml"], kind, name)

    return provoke


#: Kind: how to provoke it, what the message names, why it says.
MACHINES: dict[str, tuple[Callable, tuple[str, ...], str]] = {
    "no Slurm": (_without_slurm, ("sinfo", "--workflow-profile"), "is not on the PATH"),
    "Slurm is silent": (_silent, ("unable to contact the controller",), "does not answer"),
    "no partition": (_asks(slurm_partition="fast"), ("'fast'", "tets", "cpu, gpu"), "has no partition"),
    "no GPU in the partition": (_asks(gpu=1), ("tets", "cpu"), "has none"),
    "memory": (_asks(mem_mb=64001), ("tets", "64001 MB", "64000 MB"), "asks for"),
    "time": (_asks(runtime=121), ("tets", "121 min", "120"), "waits for ever"),
    "earlier jobs": (_busy, ("1 Slurm job", "`scancel 17`"), "an earlier run still has"),
    "no accounts": (_accounts("300", "sacct"), ("accounting storage is disabled", "profile"), "keeps no accounts"),
    "short memory": (_accounts("60", "squeue"), ("60 s", "40"), "forgets a job"),
    "no driver": (_no_gpu, ("a GPU",), "finds no GPU here"),
    "too few GPUs": (_two_gpus(3), ("3 GPUs", "has 2"), "asked for"),
    "hidden GPUs": (_two_gpus(2, "1"), ("2 GPUs", "CUDA_VISIBLE_DEVICES='1'"), "shows 1"),
    "GPUs claimed twice": (_two_gpus(2), ("GPUs",), "are claimed already"),
    "busy GPU": (_claimed_elsewhere, ("a GPU", "0.1 s", "`vibraverse gpus`"), "did not come free"),
    "no Apptainer": (_without_apptainer, ("apptainer", "--workflow-profile"), "is not on the PATH"),
    "folder of images": (_spaces, ("/my images", "VIBRAVERSE_IMAGES"), "has a space in its name"),
    "no image": (_no_image, (".sif", "`make containers`"), "does not exist"),
    "unseen meshes": (_unseen, ("/data/mug.obj", "--apptainer-args"), "do not see"),
    "unknown rule": (
        lambda *_: preflight.rules(["tet"], ["tets"]), ("set-resources", "'tet'", "'tets'"), "unknown rule",
    ),
    "unknown profile": (
        lambda *_: preflight.profile(["--workflow-profile", "gone"]), ("gone", "--workflow-profile"), "does not exist",
    ),
    "missing files of slices": (lambda *_: preflight.slices(["a/0.h5"]), ("`slice: join`", "0.h5"), "do not exist"),
    "unknown object": (_known("object", "nutt"), ("'nutt'", "'nut'", "mine.yaml"), "unknown object"),
    "unwritable": (
        lambda *_: preflight.configuration("/sys/config.yaml", "{}"), ("/sys/config.yaml",), "cannot be written",
    ),
}  # fmt: skip
