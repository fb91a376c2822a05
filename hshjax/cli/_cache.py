"""Compiled programs, kept from one run of the command to the next."""

LARGEST = 256 * 2**20
"""Bytes, beyond which what was not used for longest is dropped. Photometric stereo of an object has 2 MB."""


def keep_programs() -> None:
    """JAX's compilation cache in the user's cache directory, unless `JAX_COMPILATION_CACHE_DIR` names another;
    `JAX_ENABLE_COMPILATION_CACHE=false` has none, nor has a home that cannot be written."""
    import jax
    from platformdirs import user_cache_path

    if jax.config.values["jax_compilation_cache_dir"] is None:
        folder = user_cache_path("hshjax") / "programs"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:  # results are the same, a little later
            return
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_compilation_cache_max_size", LARGEST)
    # Hundreds of small programs take most of the time.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
