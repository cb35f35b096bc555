"""Foreign label formats: one file each. Their frames and their key names exist here and nowhere else."""
