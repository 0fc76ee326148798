"""What `fab` finds: the tasks, nothing else."""

from fleet.tasks import ns

__all__ = ["ns"]
