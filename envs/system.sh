#!/usr/bin/env bash
# Install the entries of envs/system.txt that this machine lacks.
#
#   envs/system.sh PYTHON run     install everything listed under "run", or fail and say what to do
#   envs/system.sh PYTHON test    install what is listed under "test" if possible; otherwise only print a note
#
# apt runs only when something is missing, and only as root or with a sudo that asks for no password.
set -euo pipefail

here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
python=$1 purpose=$2

# Prints "name package" for each missing entry. A library counts as present if it can be loaded, so that modules,
# LD_LIBRARY_PATH and other distributions' folders count too.
missing() {
    "$python" -I - "$here/system.txt" "$purpose" <<'PYTHON'
import ctypes, importlib.util, shutil, sys

def loads(name):
    try:
        ctypes.CDLL(name)
    except OSError:
        return False
    return True

found = {"module": importlib.util.find_spec, "library": loads, "command": shutil.which}
for line in open(sys.argv[1]):
    purpose, kind, name, package = line.split() if line[0] not in "#\n" else [None] * 4
    if purpose == sys.argv[2] and not found[kind](name):
        print(name, package)
PYTHON
}

absent=$(missing)
[ -n "$absent" ] || exit 0
names=$(cut -d' ' -f1 <<<"$absent" | paste -sd' ')
packages=$(cut -d' ' -f2 <<<"$absent" | sort -u | paste -sd' ')
install="apt-get install -y --no-install-recommends $packages"

# Fails if the entries are needed to run; otherwise only prints a note.
give_up() {
    echo "$1" >&2
    if [ "$purpose" = run ]; then exit 1; else exit 0; fi
}

if ! command -v apt-get >/dev/null; then
    give_up "Missing on this system: $names. Install what provides it (on Debian: $packages) and run the same command again."
fi
if [ "$(id -u)" = 0 ]; then
    as_root=()
elif sudo -n true 2>/dev/null; then
    as_root=(sudo -n)
else
    give_up "Missing on this system: $names. Run this once, then the same command again:
  sudo $install"
fi
echo "Installing with apt: $packages"
as_root+=(env DEBIAN_FRONTEND=noninteractive)
quiet=(-qq -o Dpkg::Use-Pty=0 -o DPkg::Lock::Timeout=300)
log=$(mktemp)
trap 'rm -f "$log"' EXIT
if ! { "${as_root[@]}" apt-get "${quiet[@]}" update && "${as_root[@]}" ${install/apt-get/apt-get ${quiet[*]}}; } \
    </dev/null >"$log" 2>&1; then
    tail -n 20 "$log" >&2
    give_up "apt could not install $packages (its last words are above)."
fi
absent=$(missing)
[ -z "$absent" ] || give_up "Still missing after installing $packages: $(cut -d' ' -f1 <<<"$absent" | paste -sd' ')."
