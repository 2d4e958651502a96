"""What makes heartcase into something to install without Python; not a part of the package."""
