"""Parts of Martinelli et al. 2018."""
