"""How do an image's bytes reach a robot: only those that are missing, and in spite of the link?"""
