"""The exceptions of the package. Every mistake of a user, a file or a driver becomes one of them."""


class SolariError(Exception):
    """Something asked of the package can't be done.

    The message says what was wrong, where (file, node, index, object) and what to do about it.
    """


class DeviceError(SolariError):
    """No device fits, the Vulkan loader is missing, or a device failed (lost, out of memory)."""


class CompilationError(SolariError):
    """A shader doesn't compile; the message has file:line of the file that holds the fault, and that line."""


class ValidationError(SolariError):
    """The Vulkan validation layer reported messages; they are the text of the exception."""


class CallbackError(ExceptionGroup[Exception], SolariError):
    """Callbacks of the user's raised; `exceptions` are theirs. The device is as it would be without them."""
