#!/bin/bash
# A batch as a job array of Slurm: `sbatch examples/cluster/array.sh list.csv /shared/prints`.
# Submitted again, it goes on with what is left; --requeue does so after a preemption.
#SBATCH --job-name=genmf
#SBATCH --array=1-64
#SBATCH --cpus-per-task=8
#SBATCH --mem=16G
#SBATCH --time=24:00:00
#SBATCH --requeue
exec srun genmf-mi batch "$1" --out "$2" --shard auto
