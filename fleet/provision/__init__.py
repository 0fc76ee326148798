"""The steps that make a blank robot ready for containers."""
