"""What the color images show: detectors, their files, and votes of all images for each thing."""
