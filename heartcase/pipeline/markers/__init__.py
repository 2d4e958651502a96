"""What a person marks: strokes and marker files, names of structures, painting sessions, where to paint next."""
