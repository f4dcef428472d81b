#!/usr/bin/env bash
# Install Apptainer on Debian 12, which does not package it, for the tests of this folder.
#
#   tests/cluster/apptainer.sh [FOLDER]     afterwards `apptainer` is on the PATH; it lies in FOLDER (/opt/apptainer)
#
# Debian unstable's package is built against a newer C library. So it is unpacked aside with the libraries it needs, its
# programs are told to load those, and nothing of the system's is replaced. Packages come from the mirror that apt is
# configured with. Where `apptainer` is on the PATH already, nothing is done.
set -euo pipefail

folder=${1:-/opt/apptainer}
if command -v apptainer >/dev/null; then exit 0; fi
[ "$(id -u)" = 0 ] || { echo "Apptainer can be installed here by root only (or put it on the PATH yourself)." >&2; exit 1; }

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export DEBIAN_FRONTEND=noninteractive
quiet=(-qq -o DPkg::Lock::Timeout=300 -o Dpkg::Use-Pty=0)
missing=()
for package in squashfs-tools patchelf mmdebstrap; do
    dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
done
if [ "${#missing[@]}" -gt 0 ]; then
    apt-get "${quiet[@]}" update && apt-get "${quiet[@]}" install -y --no-install-recommends "${missing[@]}" >/dev/null
fi

# An apt of its own, which sees unstable alone.
mirror=$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' | head -n 1)
mkdir -p "$work"/{lists,cache/archives}/partial "$work/unpacked"
echo "deb $mirror sid main" >"$work/sources.list"
aside=(-qq -o Dir::Etc::SourceList="$work/sources.list" -o Dir::Etc::SourceParts=- -o Dir::State::Lists="$work/lists"
    -o Dir::Cache="$work/cache" -o Dir::State::status=/dev/null -o Acquire::Languages=none -o APT::Sandbox::User=root)
apt-get "${aside[@]}" update
(cd "$work" && apt-get "${aside[@]}" download apptainer libc6 libseccomp2 libsqlite3-0)
for package in "$work"/*.deb; do dpkg-deb -x "$package" "$work/unpacked"; done

# Its programs look for etc/ and var/ beside themselves, one of them a folder deeper.
mkdir -p "$folder/bin" "$folder/package/var/lib/apptainer/mnt/session"
cp -a "$work/unpacked/usr/." "$work/unpacked/etc" "$folder/package/"
ln -s ../var ../etc "$folder/package/lib/"
libraries=$folder/package/lib/x86_64-linux-gnu
for program in "$folder/package/bin/apptainer" "$libraries/apptainer/bin/starter"; do
    patchelf --set-interpreter "$libraries/ld-linux-x86-64.so.2" --force-rpath --set-rpath "$libraries" "$program"
done
patchelf --force-rpath --set-rpath "$libraries" "$libraries/libsqlite3.so.0"
cat >"$folder/bin/apptainer" <<'SCRIPT'
#!/usr/bin/env bash
# Apptainer, also for a root who lacks capabilities (inside another container, say): it gives up the others when it runs an
# image, and builds one in a user namespace, where it has all of them.
apptainer=$(dirname "$(realpath "$0")")/../package/bin/apptainer
capabilities=$(sed -n 's/^CapEff:\t*//p' /proc/self/status)
if [ "$(id -u)" != 0 ] || [ $((0x$capabilities >> 24 & 1)) = 1 ]; then exec "$apptainer" "$@"; fi
if [ "${1:-}" != build ]; then APPTAINER_NO_PRIVS=1 exec "$apptainer" "$@"; fi
exec 3>&1 4>&2
coproc INSIDE { exec unshare -U bash -c 'echo ready; read -r _; exec "$@" </dev/null >&3 2>&4' - "$apptainer" "$@"; }
pid=$INSIDE_PID
trap 'kill "$pid" 2>/dev/null' INT TERM
read -r _ <&"${INSIDE[0]}"
for kind in uid gid; do echo "0 0 65536" >"/proc/$pid/${kind}_map"; done
echo go >&"${INSIDE[1]}"
wait "$pid"
SCRIPT
chmod +x "$folder/bin/apptainer"
ln -sf "$folder/bin/apptainer" /usr/local/bin/apptainer
