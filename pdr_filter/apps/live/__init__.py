"""Live server: phones send samples while they are carried, and a page shows their tracks."""
