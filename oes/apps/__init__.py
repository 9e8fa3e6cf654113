"""Programs for people: demo, viewer, evaluation on your own meshes."""
