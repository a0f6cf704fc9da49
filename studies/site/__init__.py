"""Pages of the project: an offline site made from the READMEs of the packages and from the code."""
