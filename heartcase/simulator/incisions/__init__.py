"""What an incision is worth, in numbers: what is seen and reached through it, what it strains, and how near it goes."""
