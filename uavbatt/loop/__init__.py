"""Close the loop: residual, candidate effects, refit, diagnosis, extended battery file, error before and after."""
