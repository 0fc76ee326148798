"""The images of this computer: building, finding, reading them."""
