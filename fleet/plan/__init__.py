"""Which steps bring a robot where it should be. Pure: values in, values out."""
