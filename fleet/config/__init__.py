"""What a person wrote: the inventory, the selection, the stack."""
