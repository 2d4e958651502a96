"""Sutures and patches."""
