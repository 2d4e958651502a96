"""What a page shows without a server: files that a browser opens from a folder or a static website."""
