"""What a recording of an operating session may say: commands, header, log."""
