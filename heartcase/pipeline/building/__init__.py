"""From a recipe to a case: runs the stages through the cache, locks a recipe, makes the case's identifier."""
