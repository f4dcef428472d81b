# From a folder of meshes to a dataset and its report. Rules are contracts: each calls one `vibraverse` subcommand.
import os
from pathlib import Path

from snakemake.utils import min_version

from vibraverse.contract.products import read_json
from vibraverse.contract.texts import advised
from vibraverse.machine import internals, preflight

min_version("9.20")

# A file given with --configfile is the whole configuration (rules/common.smk); config.yaml is then not read.
if not internals.config_files(workflow):
    with preflight.readable("config.yaml"):

        configfile: "config.yaml"


report: "workflow/report/workflow.rst"


include: "workflow/rules/common.smk"


for name in sorted(path.name for path in Path(workflow.basedir, "workflow/rules").glob("*.smk")):
    if name not in ("common.smk", "preflight.smk"):

        include: f"workflow/rules/{name}"


include: "workflow/rules/preflight.smk"


rule all:
    default_target: True
    input:
        targets.everything(plan),


onsuccess:
    if plan.owned is not None:
        print(f"Slice {plan.config.slice} is made. When all are: --config slice=join")
    elif os.path.exists(paths.dataset_record):
        counts = read_json(paths.dataset_record)["counts"]
        refused, left = counts["refused_objects"], counts["objects"]
        why = advised("refusals", results=paths.results)
        print(f"The dataset: {refused} of {left + refused} objects refused; {why} says why")
        for title, page in (("report", paths.report), ("page of learning", paths.learn_page)):
            if os.path.exists(page):
                print(f"The {title}: {page}")


onerror:
    print("The run ended with an error. What is done stays; repeat the command when its cause is mended.")
    if os.path.exists(paths.report):
        print(f"The report, as far as it goes: {paths.report}")
