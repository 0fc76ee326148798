"""Tells catkin where the Python package is; catkin runs this, not pip."""

from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import setup

setup(**generate_distutils_setup(packages=["talker"], package_dir={"": "src"}))
