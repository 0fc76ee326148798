"""Virtual Pis: a fleet without owning one."""
