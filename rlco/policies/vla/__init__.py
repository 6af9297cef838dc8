"""Vision-language-action models under the same interface as the small policies."""
