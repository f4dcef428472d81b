"""Everything that a run needs from its machine: locks, threads, GPUs, Slurm, images, Snakemake itself."""
