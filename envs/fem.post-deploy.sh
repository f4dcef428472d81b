#!/usr/bin/env bash
# Snakemake runs this in each conda environment it has just made (--sdm conda): it adds the project itself.
#
# Snakemake copies the script away before running it, so the project is found from the folder Snakemake works in, which is
# it or lies inside it. For a run elsewhere (--directory) VIBRAVERSE_PROJECT names it.
set -euo pipefail

project=${VIBRAVERSE_PROJECT:-$PWD}
until grep -qs '^name = "vibraverse"' "$project/pyproject.toml"; do
    if [ "$project" = / ] || [ "$project" = . ] || [ -n "${VIBRAVERSE_PROJECT:-}" ]; then
        echo "No vibraverse project at ${VIBRAVERSE_PROJECT:-$PWD}: set VIBRAVERSE_PROJECT to its folder." >&2
        exit 1
    fi
    project=$(dirname "$project")
done
python -m pip install --quiet --no-deps --no-build-isolation --editable "$project"
