#!/usr/bin/env bash
# Snakemake runs this in each conda environment after making it (--sdm conda); it installs this project there.
#
# Snakemake runs a copy of the script elsewhere, so the project is searched upwards from the working folder. For a run in
# another folder (--directory), set VIBRAVERSE_PROJECT to the project.
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
# The environment that writes pages gets their library.
if python -c 'import jinja2' 2>/dev/null; then python "$project/envs/front.py"; fi
