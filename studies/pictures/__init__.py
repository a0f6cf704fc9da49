"""Pictures of frames and meshes, in space or as a section."""
