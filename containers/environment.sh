# What holds for every process in an image; sourced by both its definition and each start.
# Nothing of the host's Python, though variables and home folder come along. Empty, because unset does not reach a container.
export PYTHONPATH= PYTHONHOME= PYTHONNOUSERSITE=1
export PATH="/opt/vibraverse/env/bin:$PATH"
# Loops compiled when the image was built, for any processor since about 2015, whatever it was built on.
export NUMBA_CACHE_DIR=/opt/vibraverse/numba NUMBA_CPU_NAME=x86-64-v3 NUMBA_CPU_FEATURES=+avx2,+bmi,+bmi2,+f16c,+fma,+lzcnt,+movbe
# Libraries that keep caches of their own find a place to write.
export MPLCONFIGDIR="${TMPDIR:-/tmp}"
