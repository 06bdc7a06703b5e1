"""The functions and structures of CUDA's driver that are used, and HIP's names of the same."""

# Only what is called, with the types of cuda.h; reserved fields keep the sizes that the driver expects.
HEADER = """
typedef int CUdevice;
typedef struct { char bytes[16]; } CUuuid;
typedef unsigned long long CUdeviceptr;
typedef void *CUcontext, *CUstream, *CUevent, *CUexternalMemory, *CUexternalSemaphore;
typedef union { int fd; struct { void *handle; void *name; } win32; } Handle;
typedef struct {
    int type; Handle handle; unsigned long long size; unsigned flags; unsigned reserved[16];
} CUDA_EXTERNAL_MEMORY_HANDLE_DESC;
typedef struct {
    unsigned long long offset; unsigned long long size; unsigned flags; unsigned reserved[16];
} CUDA_EXTERNAL_MEMORY_BUFFER_DESC;
typedef struct {
    int type; Handle handle; unsigned flags; unsigned reserved[16];
} CUDA_EXTERNAL_SEMAPHORE_HANDLE_DESC;
typedef struct {
    struct {
        unsigned long long value; unsigned long long nvSciSync;
        struct { unsigned long long key; unsigned timeoutMs; } keyedMutex;
        unsigned reserved[10];
    } params;
    unsigned flags; unsigned reserved[16];
} CUDA_EXTERNAL_SEMAPHORE_WAIT_PARAMS;
typedef struct {
    struct {
        unsigned long long value; unsigned long long nvSciSync; unsigned long long key; unsigned reserved[12];
    } params;
    unsigned flags; unsigned reserved[16];
} CUDA_EXTERNAL_SEMAPHORE_SIGNAL_PARAMS;
int cuInit(unsigned);
int cuGetErrorString(int, const char **);
int cuDeviceGetCount(int *);
int cuDeviceGet(CUdevice *, int);
int cuDeviceGetUuid_v2(CUuuid *, CUdevice);
int cuDevicePrimaryCtxRetain(CUcontext *, CUdevice);
int cuDevicePrimaryCtxRelease_v2(CUdevice);
int cuCtxPushCurrent_v2(CUcontext);
int cuCtxPopCurrent_v2(CUcontext *);
int cuImportExternalMemory(CUexternalMemory *, const CUDA_EXTERNAL_MEMORY_HANDLE_DESC *);
int cuExternalMemoryGetMappedBuffer(CUdeviceptr *, CUexternalMemory, const CUDA_EXTERNAL_MEMORY_BUFFER_DESC *);
int cuDestroyExternalMemory(CUexternalMemory);
int cuMemFree_v2(CUdeviceptr);
int cuImportExternalSemaphore(CUexternalSemaphore *, const CUDA_EXTERNAL_SEMAPHORE_HANDLE_DESC *);
int cuWaitExternalSemaphoresAsync(
    const CUexternalSemaphore *, const CUDA_EXTERNAL_SEMAPHORE_WAIT_PARAMS *, unsigned, CUstream);
int cuSignalExternalSemaphoresAsync(
    const CUexternalSemaphore *, const CUDA_EXTERNAL_SEMAPHORE_SIGNAL_PARAMS *, unsigned, CUstream);
int cuDestroyExternalSemaphore(CUexternalSemaphore);
int cuStreamCreate(CUstream *, unsigned);
int cuStreamDestroy_v2(CUstream);
int cuCtxSynchronize(void);
int cuEventCreate(CUevent *, unsigned);
int cuEventRecord(CUevent, CUstream);
int cuEventSynchronize(CUevent);
int cuEventDestroy_v2(CUevent);
int cuMemcpyDtoH_v2(void *, CUdeviceptr, size_t);
int cuMemcpyDtoDAsync_v2(CUdeviceptr, CUdeviceptr, size_t, CUstream);
int cuStreamSynchronize(CUstream);
int cuStreamQuery(CUstream);
"""
HIP = {
    "cuInit": "hipInit", "cuGetErrorString": "hipDrvGetErrorString", "cuDeviceGet": "hipDeviceGet",
    "cuDevicePrimaryCtxRetain": "hipDevicePrimaryCtxRetain",
    "cuDevicePrimaryCtxRelease_v2": "hipDevicePrimaryCtxRelease", "cuCtxPushCurrent_v2": "hipCtxPushCurrent",
    "cuCtxPopCurrent_v2": "hipCtxPopCurrent", "cuImportExternalMemory": "hipImportExternalMemory",
    "cuExternalMemoryGetMappedBuffer": "hipExternalMemoryGetMappedBuffer",
    "cuDestroyExternalMemory": "hipDestroyExternalMemory", "cuMemFree_v2": "hipFree",
    "cuEventCreate": "hipEventCreateWithFlags", "cuEventRecord": "hipEventRecord",
    "cuEventSynchronize": "hipEventSynchronize", "cuEventDestroy_v2": "hipEventDestroy",
    "cuCtxSynchronize": "hipCtxSynchronize", "cuMemcpyDtoDAsync_v2": "hipMemcpyDtoDAsync",
    "cuStreamSynchronize": "hipStreamSynchronize",
}  # fmt: skip
"""HIP's names of the functions that it needs (hip_runtime_api.h of ROCm 5 to 7)."""
