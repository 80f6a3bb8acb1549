"""Parts of Susi et al. 2013."""
