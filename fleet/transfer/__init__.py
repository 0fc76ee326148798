"""Which bytes a robot lacks, and how they get there."""
