"""Parts of Guo et al. 2018."""
