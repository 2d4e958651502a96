"""The studio: a page in the browser, on the user's own machine, where a case is made by hand and eye."""
