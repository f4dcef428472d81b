"""Reading and writing of files: meshes, tetrahedra, modal bases and modes."""
