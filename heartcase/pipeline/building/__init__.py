"""From a recipe to a case: runs the stages through the cache, checks inputs, locks recipes."""
