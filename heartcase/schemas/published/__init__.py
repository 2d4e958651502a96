"""The formats as JSON Schemas and as pages of tables, made from the models themselves."""
