"""Carrying plans out on many robots."""
