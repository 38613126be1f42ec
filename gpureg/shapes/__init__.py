"""Convert meshes and point clouds of other libraries to arrays and back; find out whether curves are closed."""
