"""The stages of a build in their order, one module each: what a stage takes of a recipe and what it leaves."""
