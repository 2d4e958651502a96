"""What an incision is worth, against scenes whose answer is a formula."""
