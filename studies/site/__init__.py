"""The site of the project by MkDocs: its pages, a gallery, and the code."""
