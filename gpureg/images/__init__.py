"""Images: denoising, filters, inpainting, graphs of patches."""
