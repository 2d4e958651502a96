"""What a guided tour of a case may say: text, places, scenes, questions; and how it is read from Markdown."""
