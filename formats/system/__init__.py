"""The system below: native kernels, threads, optional libraries, and what operating systems do in their own ways."""
