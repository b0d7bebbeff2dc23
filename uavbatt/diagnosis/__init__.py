"""CLOSE THE LOOP: residual, candidate effects, refit, diagnosis, extended battery file, error before and after."""
