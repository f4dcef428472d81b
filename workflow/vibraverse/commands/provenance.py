"""``vibraverse provenance``: trace a product back to its source, with versions and the commands that remake it."""

from __future__ import annotations

import argparse
import json
import shlex
from contextlib import suppress
from pathlib import Path

from vibraverse.contract import products
from vibraverse.contract.errors import UsageError
from vibraverse.contract.readable import unreadable
from vibraverse.contract.refusal import read_refusal
from vibraverse.contract.step import option
from vibraverse.contract.texts import advised, counted
from vibraverse.dataset.schema import MAKING
from vibraverse.flow.chain import shards_in
from vibraverse.flow.paths import SOLIDITIES, Paths
from vibraverse.flow.steps import BY_NAME
from vibraverse.upkeep.lineage import Made, chain, jobs, logged, makers, needed, packed_jobs

#: Objects of a shard or dataset up to which all chains are printed; with more, --object chooses one.
_MAX_CHAINS = 3


def main(argv: list[str]) -> int:
    """Print the chain of a product, from the source on."""
    parser = argparse.ArgumentParser(
        prog="vibraverse provenance",
        description="Say where a product comes from: every stage from the source on, with versions, checksums, and the "
        "command that rebuilds its products. Products are found below the results folder of the file.",
    )
    parser.add_argument(
        "file", type=Path, metavar="FILE", help="any product: of an object, a shard, the index"
    )
    parser.add_argument("--object", metavar="ID", help="of a shard or the dataset, only this object")
    parser.add_argument(
        "--commands",
        action="store_true",
        help="only the commands, in order: a script that rebuilds the file",
    )
    chosen = parser.parse_args(argv)
    missing = "name a product, as in results/objects/ID/surface.ply"
    if wrong := unreadable(chosen.file, missing=missing, folder=_instead(chosen.file)):
        raise UsageError(f"{chosen.file} {wrong}")
    paths, inside = _results_of(chosen.file)
    if inside[0] == "objects":
        made = makers(jobs(paths, inside[1])).get(Path(paths.results, *inside))
        if made is None:
            raise UsageError(
                f"{chosen.file} is not a product of a stage; name one, as in results/objects/ID/surface.ply"
            )
        found, last = chain([made]), []
    elif inside[:3] == ("report", "data", "objects"):
        found, last = _of_page(paths, chosen.file)
    else:
        found, last = _of_dataset(paths, chosen.file, "/".join(inside), chosen.object)
    if chosen.commands:
        print("\n".join([*(made.command() for made in found), *(command for _, command in last)]))
        return 0
    objects = {made.object for made in found}
    if len(objects) > _MAX_CHAINS:
        print(
            f"# {counted(len(objects), 'object')}, each made from a source of its own; --object ID shows one."
        )
        found = []
    for made in found:
        print(_description(made))
    print("\n".join(f"{what}\n    again  {command}" for what, command in last))
    return 0


def _instead(folder: Path) -> str:
    """Return the advice for a folder named as a product: a product in it, if it holds one."""
    for pattern in ("[!.]*", "*/[!.]*"):
        for path in folder.glob(pattern):
            with suppress(UsageError):
                if _results_of(path) and path.is_file():
                    return f"name a product in it, such as {path}"
    return "name a product"


def _results_of(file: Path) -> tuple[Paths, tuple[str, ...]]:
    """Return the results folder of a product, and the parts of its path below that."""
    if file.parent.name == "shards":  # the dataset's folder may have been renamed
        return Paths(str(file.parent.parent.parent)), ("dataset", "shards", file.name)
    parts = file.parts
    for place in range(len(parts) - 2, -1, -1):
        of_page = parts[place - 2 : place] == ("report", "data")
        if parts[place] in ("objects", "dataset", "report") and not of_page:
            return Paths(str(Path(*parts[:place]))), parts[place:]
    if file.name == "verdict.json":
        return Paths(str(file.parent)), (file.name,)
    raise UsageError(
        f"{file} is not in a results folder; name a product with its path, as in results/objects/ID/surface.ply"
    )


def _of_dataset(
    paths: Paths, file: Path, inside: str, only: str | None
) -> tuple[list[Made], list[tuple[str, str]]]:
    """Return the jobs of the objects in a shard or in all shards, and the later jobs as text and command."""
    import h5py

    is_shard = inside.startswith("dataset/shards/")
    shards = [file] if is_shard else shards_in(paths.dataset)
    held: dict[str, list[Made]] = {}
    last = []
    for shard in shards:
        with h5py.File(shard) as h5:
            names, provenance = list(h5["objects"]), json.loads(h5.attrs["provenance"])
            making = json.loads(h5[MAKING].asstr()[()])
            asked = [name for name in names if only in (None, name)]
            for name in asked:
                here = [made for made in chain(jobs(paths, name)) if made.record.is_file()]
                held[name] = here or packed_jobs(paths, name, h5["objects"][name], making)
        options = {**provenance["options"], "results": paths.results, "objects": names}
        words = ["dataset", "--shard", shard, "--options", json.dumps(options, ensure_ascii=False)]
        if asked:
            last.append(
                (
                    f"{_versions(provenance)}\n    makes  {shard}: {counted(len(names), 'object')}",
                    _command(words),
                )
            )
    if not held and only is not None:
        raise UsageError(
            f"{file} holds no object {only!r}; take --object from the first column of dataset/index.tsv"
        )
    last += [] if is_shard else _after_shards(paths, shards, file, inside)
    return [made for each in held.values() for made in each], last


def _of_page(paths: Paths, file: Path) -> tuple[list[Made], list[tuple[str, str]]]:
    """Return the jobs of the object or body that data of the page are about, and the page's job as text and command."""
    object_id, _, rest = file.name.partition(".")  # ids hold no point
    solidity = rest.split(".")[0]
    if not Path(paths.at(paths.object, object=object_id)).is_dir():
        raise UsageError(
            f"{file} is about no object of {paths.results}; name a product, as in results/objects/ID/surface.ply"
        )
    if solidity in SOLIDITIES:
        stage, log = "page_body", paths.log("page_body", "object", "solidity")
        about = needed(paths, object_id, solidity, "modes")
    else:
        stage, log = "page_object", paths.log("page_object", "object")
        about = [made for made in chain(jobs(paths, object_id)) if made.record.is_file()]
    command = _logged_command(Path(paths.at(log, object=object_id, solidity=solidity)), file)
    return about, [(f"{stage}\n    makes  {file}", command)]


def _logged_command(log: Path, file: Path) -> str:
    """Return the command at the beginning of the log of the job that made a file."""
    if not log.is_file():
        raise UsageError(
            f"{log}, which holds the command that made {file}, does not exist; delete {file} and repeat the run"
        )
    return log.read_text(encoding="utf-8").split("\n")[0]


def _after_shards(paths: Paths, shards: list[Path], file: Path, inside: str) -> list[tuple[str, str]]:
    """Return the jobs that made the products of all shards, as text and command."""
    record = Path(paths.dataset_record)
    made = products.read_provenance(record)
    words = ["index", "--shards", *shards]
    if "resolved" in made["input_sha256"]:
        words += ["--resolved", paths.config]
    if "kept" in made["input_sha256"]:
        words += [f"--kept={file}" for file in logged(paths.log("index"), "--kept=") or ["FILE"]]
    for name, output in BY_NAME["index"].outputs.items():
        place = getattr(paths, output.pattern)
        words += [option(name), place] if not output.optional or Path(place).is_file() else []
    command = _command([*words, "--options", json.dumps(made["options"], ensure_ascii=False)])
    found = [(f"{_versions(made)}\n    makes  {record}", command)]
    if inside == "verdict.json":
        share = products.read_json(file)["max_refused_share"]
        words = ["refusals", "--record", record, "--check", share, "--verdict", file]
        found.append((f"verdict\n    makes  {file}", _command(words)))
    elif inside.startswith("report/"):
        command = _logged_command(Path(paths.log("report")), file)
        found.append((f"report\n    makes  {file}", command))
    return found


def _command(words: list) -> str:
    return shlex.join(["vibraverse", *map(str, words)])


def _versions(provenance: dict) -> str:
    libraries = ", ".join(f"{name} {version}" for name, version in provenance["libraries"].items())
    return (
        f"{provenance['stage']}, version {provenance['stage_version']} of vibraverse {provenance['vibraverse']}"
        + (f", with {libraries}" if libraries else "")
    )


def _description(made: Made) -> str:
    """Return a job as text: versions, inputs with their checksums, outputs, and its command."""
    refusal = None if made.stated else read_refusal(made.record)
    if refusal is not None:
        return f"{made}: refused at {refusal.stage}: {refusal.message}"
    if not made.provenance:
        return (
            f"{made}: {made.record} is missing or states no provenance; run the workflow, or "
            f"{advised('repair', results=made.paths.results)}"
        )
    lines = [f"{made}: {_versions(made.provenance)}"]
    if made.step.name == "sources":
        lines.append(f"    from   {_source(made.content)}")
    stated = made.provenance.get("input_sha256", {})
    for name, digest in stated.items():
        path = made.input(name) if name in made.step.chained else None
        lines.append(f"    from   {path or name}  {digest[:16]}{_change(path, digest)}")
    lines += [f"    makes  {path}" for path in made.outputs]
    return "\n".join([*lines, f"    again  {made.command()}"])


def _change(path: Path | None, digest: str) -> str:
    """Return how an input differs from its stated checksum, to follow it in a line; "" if it does not."""
    if path is None:
        return ""
    if not path.is_file():
        return ", not here"
    return "" if products.sha256(path) == digest else ", changed since"


def _source(record: dict) -> str:
    """Return the origin of a mesh from the record of ``sources``."""
    known = (record.get(key) for key in ("origin", "file", "url", "uid", "attribution"))
    return ", ".join(
        [*dict.fromkeys(str(value) for value in known if value), f"licence {record.get('licence')}"]
    )
