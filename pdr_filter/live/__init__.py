"""Phones that send while somebody walks: a server with a page, and what it needs of each phone."""
