#!/usr/bin/env bash
# A small Slurm on this one machine, for the tests of this folder: Debian's packages, several slurmd as nodes, no systemd,
# no cgroups, no accounting.
#
#   tests/cluster/slurm.sh start     install what is missing; afterwards sbatch, squeue and sinfo work
#   tests/cluster/slurm.sh stop      cancel its jobs and end its processes
#   tests/cluster/slurm.sh kill N    end node N's slurmd and its jobs as a crash of the machine would
#   tests/cluster/slurm.sh node N    start node N's slurmd (again)
#   tests/cluster/slurm.sh away      end the controller, so that Slurm does not answer; its jobs go on
#   tests/cluster/slurm.sh back      start the controller again
#
# Partitions: cpu (n1, n2) and gpu (n3, two stand-in devices). Memory limits are enforced by Slurm's accounting of processes.
# A machine that has a Slurm of its own is left alone.
set -euo pipefail

state=/var/lib/vibraverse-slurm
conf=/etc/slurm/slurm.conf
mark="# Written by vibraverse tests/cluster/slurm.sh"
nodes=(n1 n2 n3)

fail() {
    echo "$*" >&2
    exit 1
}

install_packages() {
    if command -v slurmctld >/dev/null && command -v slurmd >/dev/null && command -v munged >/dev/null; then return; fi
    export DEBIAN_FRONTEND=noninteractive
    local quiet=(-qq -o DPkg::Lock::Timeout=300 -o Dpkg::Use-Pty=0)
    apt-get "${quiet[@]}" update
    apt-get "${quiet[@]}" install -y --no-install-recommends slurm-wlm munge >/dev/null
}

write_configuration() {
    local cpus memory node port=17001
    cpus=$(env -u OMP_NUM_THREADS nproc) # which the tests set, and nproc heeds
    memory=$(awk '/MemTotal/ {print int($2 / 1024)}' /proc/meminfo)
    mkdir -p "$state"/{ctld,log} /etc/slurm
    cat >"$conf" <<CONF
$mark
ClusterName=one-machine
SlurmctldHost=$(hostname -s)(127.0.0.1)
SlurmctldPort=17000
AuthType=auth/munge
SlurmUser=root
SlurmdUser=root
StateSaveLocation=$state/ctld
SlurmdSpoolDir=$state/%n
SlurmctldPidFile=$state/slurmctld.pid
SlurmdPidFile=$state/%n.pid
SlurmctldLogFile=$state/log/slurmctld.log
SlurmdLogFile=$state/log/%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/linux
JobAcctGatherFrequency=1
JobAcctGatherParams=OverMemoryKill
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
SlurmdParameters=config_overrides
AccountingStorageType=accounting_storage/none
MpiDefault=none
MailProg=/bin/true
ReturnToService=2
SlurmdTimeout=20
MinJobAge=3600
KillWait=5
SchedulerParameters=sched_min_interval=200000,bf_interval=5
GresTypes=gpu
CONF
    for node in "${nodes[@]}"; do
        mkdir -p "$state/$node"
        echo "NodeName=$node NodeHostname=$(hostname -s) NodeAddr=127.0.0.1 Port=$((port++)) CPUs=$cpus RealMemory=$memory" \
            "$([ "$node" = n3 ] && echo Gres=gpu:2)" >>"$conf"
    done
    echo "PartitionName=cpu Nodes=n1,n2 Default=YES MaxTime=120 State=UP" >>"$conf"
    echo "PartitionName=gpu Nodes=n3 MaxTime=120 State=UP" >>"$conf"
    local device # of which Slurm wants to know that it is one: twins of /dev/null
    for device in "$state/gpu0" "$state/gpu1"; do [ -c "$device" ] || { rm -f "$device" && mknod "$device" c 1 3; }; done
    echo "NodeName=n3 Name=gpu File=$state/gpu[0-1]" >/etc/slurm/gres.conf
}

start_munge() {
    if munge -n 2>/dev/null | unmunge >/dev/null 2>&1; then return; fi
    install -d -o munge -g munge -m 755 /run/munge
    [ -s /etc/munge/munge.key ] || install -o munge -g munge -m 400 <(head -c 128 /dev/urandom) /etc/munge/munge.key
    setpriv --reuid munge --regid munge --init-groups munged
    touch "$state/munge-is-ours"
}

start_node() {
    slurmd -N "$1"
}

# All processes under one.
descendants() {
    local child
    for child in $(pgrep -P "$1"); do
        echo "$child"
        descendants "$child"
    done
}

# First whoever could still tell Slurm how the jobs end.
kill_node() {
    local job step process steps=() tasks=()
    for job in $(squeue -h -w "$1" -t RUNNING -o %A); do
        for step in $(pgrep -f "^slurmstepd: \\[$job\\."); do
            steps+=("$step")
            tasks+=($(descendants "$step"))
        done
    done
    kill -9 "$(cat "$state/$1.pid")"
    for process in "${steps[@]}" "${tasks[@]}"; do kill -9 "$process" 2>/dev/null || true; done
}

stop_all() {
    [ -d "$state" ] || return 0
    scancel --user root 2>/dev/null || true
    local file pid
    for file in "$state"/slurmctld.pid "$state"/n?.pid; do
        [ -s "$file" ] || continue
        pid=$(cat "$file")
        kill "$pid" 2>/dev/null || true
        for _ in {1..50}; do kill -0 "$pid" 2>/dev/null || break; sleep 0.1; done
        rm -f "$file"
    done
    if [ -e "$state/munge-is-ours" ]; then pkill -x -u munge munged || true; fi
    rm -rf "$state"
    if grep -qsF "$mark" "$conf"; then rm -f "$conf" /etc/slurm/gres.conf; fi
}

[ "$(id -u)" = 0 ] || fail "A Slurm can be started here by root only."
if [ -e "$conf" ] && ! grep -qF "$mark" "$conf"; then fail "$conf is not of this script: this machine has a Slurm of its own."; fi
case "${1:-}" in
start)
    if sinfo -h >/dev/null 2>&1; then exit 0; fi
    install_packages
    stop_all
    write_configuration
    start_munge
    slurmctld
    for node in "${nodes[@]}"; do start_node "$node"; done
    for _ in {1..100}; do
        if [ "$(sinfo -h -N -t idle -o %N 2>/dev/null | sort -u | wc -l)" = "${#nodes[@]}" ]; then exit 0; fi
        sleep 0.2
    done
    tail -n 20 "$state"/log/*.log >&2
    fail "The nodes did not come up (the logs' last words are above)."
    ;;
stop) stop_all ;;
away) kill "$(cat "$state/slurmctld.pid")" ;;
back) slurmctld ;;
kill) kill_node "$2" ;;
node) start_node "$2" ;;
*) fail "usage: tests/cluster/slurm.sh start | stop | kill NODE | node NODE | away | back" ;;
esac
