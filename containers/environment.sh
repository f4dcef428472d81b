# The environment of every process in an image, sourced when it is built and at each start.
# Apptainer passes the host's variables and home folder on; these keep the host's Python out. They are empty because
# an unset variable would not be passed on.
export PYTHONPATH= PYTHONHOME= PYTHONNOUSERSITE=1
export PATH="/opt/vibraverse/env/bin:$PATH"
# Loops compiled when the image was built, for any processor since about 2015, not for that of the builder.
export NUMBA_CACHE_DIR=/opt/vibraverse/numba NUMBA_CPU_NAME=x86-64-v3 NUMBA_CPU_FEATURES=+avx2,+bmi,+bmi2,+f16c,+fma,+lzcnt,+movbe
# A writable folder for libraries that keep caches of their own.
export MPLCONFIGDIR="${TMPDIR:-/tmp}"
