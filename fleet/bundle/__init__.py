"""Releases of many robots on a USB stick: written by ``fab bundle``, installed there, or shipped from it."""
