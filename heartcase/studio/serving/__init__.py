"""The server of the studio: whom it lets in, the addresses of its pages, and running it on this machine."""
