"""One operating session: commands in, frames out, a history to go back and on in, and recordings of it."""
