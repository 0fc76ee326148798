"""Which steps make a blank robot ready for containers."""
