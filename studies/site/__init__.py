"""Pages of the project: a site made offline from the READMEs of its rooms and from its code."""
