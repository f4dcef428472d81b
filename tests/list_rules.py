"""Print the workflow's rules as JSON, as Snakemake understands them: ``list_rules.py SNAKEFILE CONFIG``."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from snakemake.api import ConfigSettings, OutputSettings, ResourceSettings, SnakemakeApi


def plain(value):
    """Return a pattern as in ``Paths``; for a function, its name; None without a name."""
    if callable(value):
        return f"<{getattr(value, '__name__', '').strip('<>')}>"
    if isinstance(value, list):
        return [plain(one) for one in value]
    return re.sub(r"\{(\w+),[^{}]*(?:\{\d+\})?[^{}]*\}", r"{\1}", str(value)) if value is not None else None


def main(snakefile: str, config: str) -> None:
    """Load the workflow, which plans nothing, and print."""
    with SnakemakeApi(OutputSettings()) as api:
        loaded = api.workflow(
            resource_settings=ResourceSettings(cores=1),
            config_settings=ConfigSettings(configfiles=[Path(config)]),
            snakefile=Path(snakefile),
        )
        rules = {
            rule.name: {
                **{
                    part: {name: plain(value) for name, value in getattr(rule, part).items()}
                    for part in ("input", "output", "params")
                },
                "log": [plain(path) for path in rule.log],
                "conda": rule.conda_env,
                "container": rule.container_img,
                "shell": rule.shellcmd,
            }
            for rule in loaded._workflow.rules
        }
    print(json.dumps(rules))


if __name__ == "__main__":
    main(*sys.argv[1:])
