#!/usr/bin/env bash
# Make, update or repair a virtual environment: the pinned packages, and this project installed editable.
#
#   envs/env.sh FOLDER NAME…
#
# Each NAME is an environment of this folder (envs/NAME.txt). Several can be joined, because their versions agree.
# FOLDER/.vibraverse states what the environment holds. If that is up to date, nothing is done. If it shows that a run
# was interrupted, the environment is rebuilt. PYTHON chooses the interpreter.
set -euo pipefail

cd "$(dirname "${BASH_SOURCE[0]}")/.."
folder=$(realpath -m "$1")
shift
python=$folder/bin/python
stamp=$folder/.vibraverse

fail() {
    echo "$*" >&2
    exit 1
}

# The stamp's line for one NAME: a checksum of everything it is made from.
line() {
    echo "$1 $({ echo "$folder" && cat "envs/$1.txt" envs/bootstrap.txt envs/env.sh pyproject.toml; } | sha256sum)"
}

up_to_date() {
    local name
    for name; do grep -qxF -- "$(line "$name")" "$stamp" 2>/dev/null || return 1; done
    [ -x "$python" ]
}

# The path of a suitable interpreter: the real one behind any virtual environment or shim.
choose_python() {
    local candidate
    for candidate in ${PYTHON:-python3 python3.12 python3.11}; do
        "$candidate" -I -c 'import sys; assert (3, 11) <= sys.version_info < (3, 13); print(sys._base_executable)' \
            2>/dev/null && return
    done
    fail "Python 3.11 or 3.12 is needed; ${PYTHON:-python3} is $("${PYTHON:-python3}" -V 2>/dev/null || echo not there)." \
        "Install one of them and name it: make env PYTHON=/path/to/python3.12"
}

# An empty environment with pip in it. The stamp is written first: it marks the folder as ours.
make_venv() {
    local base=$1
    if [ -d "$folder" ] && [ -n "$(ls -A "$folder")" ] && [ ! -e "$stamp" ]; then
        fail "$folder was not made by this project, so it is left alone. Move it away, or choose another with VENV=…"
    fi
    mkdir -p "$folder"
    : >>"$stamp"
    find "$folder/" -mindepth 1 ! -name .vibraverse -delete
    echo "Making $folder with $("$base" -V)"
    "$base" -m venv "$folder" || fail "$base could not make a virtual environment in $folder (see above)."
}

# uv does not read pip's configuration, so its settings (a mirror, a certificate) are passed on.
use_pip_settings() {
    local settings option variable separator value values
    settings=$("$python" -m pip config list)
    while read -r option variable separator; do
        value=$(sed -n "s/^[^=]*\.$option='\(.*\)'\$/\1/p" <<<"$settings" | head -n 1)
        read -ra values <<<"${value//\\n/ }" # pip shows the ends of lines as \n
        value=$(IFS=${separator:- } && echo "${values[*]}")
        if [ -n "$value" ] && [ -z "${!variable:-}" ]; then export "$variable=$value"; fi
    done <<<"index-url UV_DEFAULT_INDEX
        extra-index-url UV_INDEX
        find-links UV_FIND_LINKS ,
        trusted-host UV_INSECURE_HOST
        cert SSL_CERT_FILE
        proxy ALL_PROXY"
    # uv brings the public certificates; the machine may have more.
    if [ -s /etc/ssl/certs/ca-certificates.crt ]; then export UV_SYSTEM_CERTS=${UV_SYSTEM_CERTS:-true}; fi
}

# Exactly the packages of the lock files, and the project.
install() {
    local uv=$folder/bin/uv quiet=(--quiet) locks
    locks=("${@/#/envs/}")
    locks=("${locks[@]/%/.txt}")
    if [ -t 2 ]; then quiet=(); fi # on a terminal, show the progress
    "$python" -m pip install --quiet --require-hashes -r envs/bootstrap.txt
    use_pip_settings
    echo "Installing $(sort -u "${locks[@]}" | grep -c '^[a-z0-9].*==') packages: $*"
    "$uv" pip sync "${quiet[@]}" --python "$python" --require-hashes --build-constraints envs/bootstrap.txt \
        --preview-features build-dependency-hashes --require-build-hashes "${locks[@]}"
    "$uv" pip install --quiet --python "$python" --no-deps --no-build-isolation --editable .
}

# What pages consist of, in an environment that writes pages; see envs/front.py.
front() {
    local sum own=workflow/vibraverse/report
    case " $* " in *" report "* | *" workstation "* | *" dev "*) ;; *) return ;; esac
    sum=$(
        LC_ALL=C
        cat $own/front/{package.json,package-lock.json,three.js} $own/*.css $own/*.js $own/page/*.css $own/page/*.js |
            sha256sum
    )
    if [ "$(cat "$folder/share/vibraverse/front.sha256" 2>/dev/null)" != "${sum%% *}" ]; then
        "$python" envs/front.py
    fi
}

# One at a time: a second call waits here, and then finds the work done.
exec 9<envs/env.sh
flock 9 2>/dev/null || true
if up_to_date "$@"; then
    front "$@"
    exec envs/system.sh "$python" run
fi
[ "$(uname -sm)" = "Linux x86_64" ] || fail "The pinned packages are for Linux on x86-64; this is $(uname -sm)."
base=$(choose_python)
envs/system.sh "$base" run
if [ ! -s "$stamp" ] || ! "$python" -m pip --version >/dev/null 2>&1; then
    make_venv "$base"
fi
: >"$stamp"
trap '[ $? = 0 ] || echo "The packages could not be installed (see above). Run the same command again." >&2' EXIT
install "$@"
front "$@"
# A development environment holds all of the workstation's, so it serves as both.
for name; do
    line "$name"
    if [ "$name" = dev ]; then line workstation; fi
done >"$stamp.new"
mv "$stamp.new" "$stamp"
echo "$folder is ready ($(du -shL "$folder" | cut -f1)B)"
