// scene_instances.glsl: the instances of the scene, shared by the tracers and scene.glsl.
//
// Reads   binding 2
#ifndef SCENE_INSTANCES_GLSL
#define SCENE_INSTANCES_GLSL
layout(std430, binding = BINDING_INSTANCES) readonly buffer instance_buffer { scene_instance_gpu scene_instances[]; };
#endif
