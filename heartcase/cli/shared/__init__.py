"""What several commands share: what they print, and how they read and write the outputs of stages."""
