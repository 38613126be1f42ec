"""Point clouds: denoising, clusters, patches, files."""
