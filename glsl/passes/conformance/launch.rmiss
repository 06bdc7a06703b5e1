// Returns what a miss shader is told about its launch.
#version 460
#include "passes/conformance/launch.glsl"

layout(location = 0) rayPayloadInEXT Told told;

void main() {
    told = Told(gl_LaunchIDEXT, gl_LaunchSizeEXT);
}
