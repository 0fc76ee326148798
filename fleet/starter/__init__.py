"""A project of one's own: the files that ``fleet init`` writes."""
