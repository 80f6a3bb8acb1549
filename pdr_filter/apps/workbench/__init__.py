"""Local workbench: pages that list the walks of a folder, mark, place and export them, and draw floor plans."""
