"""What a file of a scripted session, or of plans of incisions, may say."""
