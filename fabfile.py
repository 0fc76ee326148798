"""What `fab` finds: the tasks, nothing else."""

from fleet.cli import ns

__all__ = ["ns"]
